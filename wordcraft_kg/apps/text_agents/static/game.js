// Play a recipe book: discover items in the open, or make goals from a table. Labels are only ever
// set as text, so a book cannot bring markup into the page.
"use strict";
(() => {
  const BOOK = JSON.parse(document.getElementById("book").textContent);
  const HINT_COST = 5; // attempts that a hint counts for
  const SHOWN = 500; // items drawn at once: more make a page slow
  const KEYS = "1234567890";
  const label = (item) => BOOK.labels[item];
  const named = (item) => (item in BOOK.icons ? `${BOOK.icons[item]} ${label(item)}` : label(item));
  const byId = (id) => document.getElementById(id);
  const make = (tag, text = "", attributes = {}) => {
    const element = document.createElement(tag);
    element.textContent = text;
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    return element;
  };
  const plus = (items) => items.map(label).join(" + ");
  const keyOf = (items) => [...items].sort((a, b) => a - b).join(",");
  const lower = (text) => text.toLocaleLowerCase();

  // Results of each multiset of ingredients, and the recipes of each result.
  const results = new Map();
  const recipesOf = new Map();
  BOOK.recipes.forEach((recipe, row) => {
    const result = recipe.at(-1);
    const key = keyOf(recipe.slice(0, -1));
    if (!results.has(key)) results.set(key, []);
    results.get(key).push(result);
    if (!recipesOf.has(result)) recipesOf.set(result, []);
    recipesOf.get(result).push(row);
  });
  const sizes = new Set(BOOK.recipes.map((recipe) => recipe.length - 1));
  const most = Math.max(2, ...sizes);
  // With pairs alone a second pick ends the attempt; else a button says that the set is complete.
  const combinesBySize = most === 2 && !sizes.has(1);
  // All tables of a level have one size, so that it tells nothing about the recipe.
  const SIZES = { easy: most + 1, medium: most + 6, hard: 2 * most + 4 };
  const ingredients = (row) => BOOK.recipes[row].slice(0, -1);
  const made = (items) => results.get(keyOf(items)) || [];

  // Recipes whose ingredients are all known, and that make something new.
  const productive = (known) =>
    BOOK.recipes.findIndex((recipe) => !known.has(recipe.at(-1)) && recipe.slice(0, -1).every((item) => known.has(item)));
  const reachable = () => {
    const known = new Set(BOOK.base);
    let grew = true;
    while (grew) {
      grew = false;
      for (const recipe of BOOK.recipes) {
        if (known.has(recipe.at(-1)) || !recipe.slice(0, -1).every((item) => known.has(item))) continue;
        known.add(recipe.at(-1));
        grew = true;
      }
    }
    return known.size;
  };
  const all = reachable();

  // Draw buttons anew, and keep the focus on the item that had it: a keyboard starts there again.
  const draw = (list, items, buttonOf) => {
    const focused = list.contains(document.activeElement) ? document.activeElement.dataset.item : undefined;
    list.replaceChildren(...items.map((item, slot) => {
      const button = buttonOf(item, slot);
      button.dataset.item = item;
      const entry = make("li");
      entry.append(button);
      return entry;
    }));
    if (focused !== undefined) list.querySelector(`[data-item="${focused}"]`)?.focus();
  };

  // --- A row of picked items, for both games.
  const tray = (root, combine, changed) => {
    let picked = [];
    const show = () => {
      const text = picked.length ? `${plus(picked)}${combinesBySize ? " + …" : ""}` : "Nothing picked.";
      root.replaceChildren(make("span", text));
      if (!combinesBySize) {
        const button = make("button", "Combine", { type: "button", class: "main" });
        button.disabled = !picked.length;
        button.addEventListener("click", finish);
        root.append(button);
      }
      if (picked.length) {
        const button = make("button", "Put back", { type: "button" });
        button.addEventListener("click", () => { picked = []; show(); changed(); });
        root.append(button);
      }
    };
    const finish = () => {
      const items = picked;
      picked = [];
      show();
      combine(items);
    };
    const pick = (item) => {
      if (picked.length < most) picked.push(item);
      if (combinesBySize && picked.length === 2) finish();
      else { show(); changed(); }
    };
    show();
    return { pick, finish, clear: () => { picked = []; show(); }, count: () => picked.length };
  };

  // --- Discover.
  const place = `wordcraft-kg ${BOOK.key}`;
  const fresh = () => ({ known: [...BOOK.base], how: {}, attempts: 0, hints: 0 });
  const stored = () => {
    // A browser may forbid storage, and another program may have written there.
    try {
      const state = JSON.parse(localStorage.getItem(place));
      const items = new Set(BOOK.labels.keys());
      const isSound = state && Array.isArray(state.known) && state.known.every((item) => items.has(item)) &&
        new Set(state.known).size === state.known.length && [state.attempts, state.hints].every((count) => Number.isInteger(count) && count >= 0) &&
        typeof state.how === "object" && state.how !== null &&
        Object.values(state.how).every((row) => Number.isInteger(row) && row >= 0 && row < BOOK.recipes.length) &&
        BOOK.base.every((item) => state.known.includes(item));
      return isSound ? state : fresh();
    } catch { return fresh(); }
  };
  let state = stored();
  let newest = new Set();
  let hint = []; // items of the last hint, and how many of them are shown
  const save = () => { try { localStorage.setItem(place, JSON.stringify(state)); } catch { /* play on */ } };

  const counted = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;
  const showCounts = () => {
    const hints = state.hints ? `, ${counted(state.hints, "hint")}` : "";
    byId("counts").textContent = `${state.known.length} of ${all} items, ${counted(state.attempts, "attempt")}${hints}.`;
  };
  const say = (text, isNew = false) => {
    byId("message").textContent = text;
    byId("message").classList.toggle("new", isNew);
  };
  const listed = () => {
    const words = lower(byId("search").value.trim());
    const items = state.known.filter((item) => lower(label(item)).includes(words));
    return byId("order").value === "name" ? items.sort((a, b) => label(a).localeCompare(label(b))) : items.reverse();
  };
  const showItems = () => {
    const items = listed();
    draw(byId("items"), items.slice(0, SHOWN), (item) => {
      const button = make("button", named(item), { type: "button" });
      button.classList.toggle("fresh", newest.has(item));
      button.classList.toggle("hinted", hint.includes(item));
      button.addEventListener("click", () => discover.pick(item));
      return button;
    });
    const hidden = items.length - SHOWN;
    byId("rest").textContent = hidden > 0 ? `${hidden} more: search for them.` : items.length ? "" : "No item has these letters.";
  };
  const showTree = () => {
    byId("tree").replaceChildren(...state.known.map((item) => {
      const row = state.how[item];
      return make("li", row === undefined ? `${label(item)}: there from the start` : `${label(item)} = ${plus(ingredients(row))}`);
    }));
  };
  const combine = (items) => {
    state.attempts += 1;
    const outcome = made(items);
    newest = new Set(outcome.filter((item) => !state.known.includes(item)));
    for (const item of newest) {
      state.known.push(item);
      state.how[item] = recipesOf.get(item).find((row) => keyOf(ingredients(row)) === keyOf(items));
    }
    hint = [];
    save();
    const text = `${plus(items)} → ${outcome.length ? outcome.map(label).join(", ") : "nothing"}`;
    say(newest.size ? `${text}. New!` : outcome.length ? `${text}. You have it already.` : `${text}.`, newest.size > 0);
    showCounts();
    showItems();
    if (newest.size) showTree();
    if (state.known.length >= all) say(`${text}. You have made all ${all} items.`, true);
  };
  const discover = tray(byId("tray"), combine, () => {});
  byId("hint").textContent = `Hint (counts as ${HINT_COST} attempts)`;
  byId("hint").addEventListener("click", () => {
    const row = productive(new Set(state.known));
    if (row < 0) return say("Your items make nothing new any more.");
    const items = ingredients(row);
    // The first hint names an item, the next one the whole set.
    const isSecond = hint.length > 0 && items.includes(hint[0]);
    hint = isSecond ? items : items.slice(0, 1);
    state.attempts += HINT_COST;
    state.hints += 1;
    save();
    say(isSecond || items.length === 1 ? `Try ${plus(items)}.` : `${label(hint[0])} is in a recipe of ${items.length} that makes something new.`);
    showCounts();
    showItems();
  });
  byId("search").addEventListener("input", showItems);
  byId("search").addEventListener("keydown", (event) => {
    const [first] = listed();
    if (event.key !== "Enter" || event.isComposing || first === undefined || !byId("search").value.trim()) return;
    discover.pick(first);
    byId("search").value = "";
    showItems();
  });
  byId("order").addEventListener("change", showItems);
  byId("restart").addEventListener("click", () => {
    [state, newest, hint] = [fresh(), new Set(), []];
    save();
    discover.clear();
    say("You start with the first items again.");
    showAll();
  });
  const showAll = () => { showCounts(); showItems(); showTree(); };
  // Another tab of the same book has stored a discovery: this one goes on from there.
  window.addEventListener("storage", (event) => {
    if (event.key !== place) return;
    state = stored();
    showAll();
  });

  // --- Goals.
  const random = (count) => Math.floor(Math.random() * count);
  const shuffled = (items) => {
    const order = [...items];
    for (let last = order.length - 1; last > 0; last -= 1) {
      const other = random(last + 1);
      [order[last], order[other]] = [order[other], order[last]];
    }
    return order;
  };
  const isMadeAtOnce = (goal, table) =>
    recipesOf.get(goal).some((row) => ingredients(row).every((item) => table.has(item)));
  // A plan is the rows of the recipes that make the goal, in order.
  const planOfTwo = () => {
    for (let trial = 0; trial < 300; trial += 1) {
      const last = random(BOOK.recipes.length);
      const goal = BOOK.recipes[last].at(-1);
      const step = ingredients(last).find((item) => recipesOf.has(item));
      if (step === undefined) continue;
      const rows = recipesOf.get(step);
      const first = rows[random(rows.length)];
      const table = new Set([...ingredients(first), ...ingredients(last).filter((item) => item !== step)]);
      if (!table.has(goal) && !table.has(step) && !isMadeAtOnce(goal, table)) return { rows: [first, last], table };
    }
    return null;
  };
  const planOfOne = () => {
    const row = random(BOOK.recipes.length);
    return { rows: [row], table: new Set(ingredients(row)) };
  };
  let task = null;
  const tally = { made: 0, played: 0 };

  const begin = () => {
    const level = byId("level").value;
    const plan = (level === "hard" && planOfTwo()) || planOfOne();
    const goal = BOOK.recipes[plan.rows.at(-1)].at(-1);
    const table = new Set(plan.table);
    // A distractor must not be the goal or a step on the way to it.
    const steps = new Set(plan.rows.map((row) => BOOK.recipes[row].at(-1)));
    const wanted = Math.min(SIZES[level], BOOK.labels.length - steps.size);
    for (let trial = 0; table.size < wanted && trial < 1000; trial += 1) {
      const item = random(BOOK.labels.length);
      if (!steps.has(item)) table.add(item);
    }
    task = { goal, rows: plan.rows, table: shuffled(table), left: plan.rows.length, tried: [], over: false };
    byId("outcome").replaceChildren();
    byId("next").hidden = true;
    game.clear();
    showGoal();
  };
  const showGoal = () => {
    byId("goal").textContent = `Make: ${label(task.goal)}`;
    const left = task.over ? "" : ` Attempts left: ${task.left}.`;
    byId("goal-counts").textContent = `Goals made: ${tally.made} of ${tally.played}.${left}`;
    draw(byId("table"), task.table, (item, slot) => {
      const key = slot < KEYS.length ? `${KEYS[slot]} ` : "";
      const button = make("button", `${key}${named(item)}`, { type: "button" });
      button.disabled = task.over;
      button.addEventListener("click", () => game.pick(item));
      return button;
    });
  };
  const attempt = (items) => {
    const outcome = made(items);
    task.left -= 1;
    task.tried.push(`${plus(items)} → ${outcome.length ? outcome.map(label).join(", ") : "nothing"}`);
    const isMade = outcome.includes(task.goal);
    for (const item of outcome) if (!task.table.includes(item)) task.table.push(item);
    task.over = isMade || task.left === 0;
    const lines = task.tried.map((line) => make("p", `You: ${line}`));
    if (task.over) {
      tally.played += 1;
      tally.made += isMade;
      const answer = task.rows.map((row) => `${plus(ingredients(row))} → ${label(BOOK.recipes[row].at(-1))}`).join("; ");
      lines.push(make("p", isMade ? `You made ${label(task.goal)}.` : `You did not make ${label(task.goal)}.`));
      lines.push(make("p", `${isMade ? "A recipe" : "The answer"}: ${answer}`));
    }
    byId("outcome").replaceChildren(...lines);
    byId("next").hidden = !task.over;
    showGoal();
    if (task.over) byId("next").focus();
  };
  const game = tray(byId("goal-tray"), attempt, () => {});
  byId("next").addEventListener("click", () => { begin(); byId("goal").focus(); });
  byId("level").addEventListener("change", begin);

  // --- Both.
  const open = (name) => {
    for (const id of ["discover", "goals"]) {
      byId(id).hidden = id !== name;
      byId(`to-${id}`).setAttribute("aria-pressed", id === name);
    }
    if (name === "goals" && !task) begin();
  };
  byId("to-discover").addEventListener("click", () => open("discover"));
  byId("to-goals").addEventListener("click", () => open("goals"));
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("input, select");
    if (isTyping || event.ctrlKey || event.altKey || event.metaKey) return;
    const isDiscovering = byId("goals").hidden;
    if (event.key === "/" && isDiscovering) {
      event.preventDefault();
      byId("search").focus();
    } else if (event.key === "Enter" && event.target === document.body && !combinesBySize) {
      const row = isDiscovering ? discover : game;
      if (row.count()) row.finish();
    } else if (event.key === "Escape") {
      (isDiscovering ? discover : game).clear();
    } else if (!isDiscovering && KEYS.includes(event.key) && !task.over) {
      const item = task.table[KEYS.indexOf(event.key)];
      if (item !== undefined) game.pick(item);
    }
  });
  if (!combinesBySize) byId("how").textContent = `Pick up to ${most} items, then combine them. Items are not used up.`;
  byId("level").querySelector("[value=easy]").textContent = `easy: ${SIZES.easy} items`;
  byId("level").querySelector("[value=medium]").textContent = `medium: ${SIZES.medium} items`;
  byId("level").querySelector("[value=hard]").textContent = `hard: ${SIZES.hard} items, two steps`;
  if (!planOfTwo()) byId("level").querySelector("[value=hard]").disabled = true;
  showAll();
})();
