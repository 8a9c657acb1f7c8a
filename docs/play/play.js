// A game on the tables of the test tasks: a person picks two items; then the agent's pick and the scorer's pairs appear.
"use strict";
(() => {
  const root = document.getElementById("play");
  if (!root || typeof TASKS === "undefined") return;
  const KEYS = "1234567890";
  const wins = { you: 0, agent: 0, scorer: 0 };
  let number = 0;
  let picked = [];
  let done = false;

  const make = (tag, text = "", attributes = {}) => {
    const element = document.createElement(tag);
    element.textContent = text;
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    return element;
  };
  const results = (task, pair) => task.made[[...pair].sort((a, b) => a - b).join(",")] || [];
  const wonBy = (task, pair) => results(task, pair).includes(task.goal);
  const words = (task, pair) => {
    const made = results(task, pair).join(", ") || "nothing";
    return `${pair.map((slot) => task.table[slot]).join(" + ")} → ${made}`;
  };

  const heading = make("h2", "", { id: "goal", tabindex: "-1" });
  const score = make("p");
  const table = make("div", "", { class: "play-table", role: "group", "aria-label": "Items on the table" });
  const answer = make("div", "", { "aria-live": "polite" });
  root.replaceChildren(heading, score, table, answer);

  const show = () => {
    const task = TASKS[number];
    heading.textContent = `Make: ${task.goal}`;
    const played = number + (done ? 1 : 0);
    score.textContent =
      `Task ${number + 1} of ${TASKS.length}. Goals made in ${played}: you ${wins.you}, agent ${wins.agent}, scorer ${wins.scorer}.`;
    table.replaceChildren(
      ...task.table.map((item, slot) => {
        const label = `${KEYS[slot] || ""} ${item}${picked.includes(slot) ? " ✓" : ""}`.trim();
        const button = make("button", label, { type: "button", "aria-pressed": picked.includes(slot) });
        button.disabled = done;
        button.addEventListener("click", () => pick(slot));
        return button;
      }),
    );
  };

  const pick = (slot) => {
    if (done || slot >= TASKS[number].table.length) return;
    picked.push(slot);
    if (picked.length === 2) finish();
    show();
    if (!done) table.children[slot].focus();
  };

  const finish = () => {
    const task = TASKS[number];
    done = true;
    const scorer = task.scorer[0].pair;
    wins.you += wonBy(task, picked);
    wins.agent += wonBy(task, task.agent);
    wins.scorer += wonBy(task, scorer);
    const mark = (pair) => (wonBy(task, pair) ? "goal made" : "not made");
    const rows = [["You", picked, ""], ["Agent", task.agent, `${(100 * task.probability[task.agent[0]]).toFixed(0)} % for the first pick`]];
    task.scorer.forEach((one, rank) => {
      const because = one.because.length ? `, because of ${one.because.join("; ")}` : "";
      rows.push([`Scorer, ${["best", "second", "third"][rank]} pair`, one.pair, `w ${one.w}${because}`]);
    });
    const list = make("table", "", { class: "play-picks" });
    const head = make("tr");
    head.append(...["who", "pair", "outcome", "why"].map((text) => make("th", text, { scope: "col" })));
    list.append(head);
    for (const [who, pair, why] of rows) {
      const row = make("tr");
      row.append(make("th", who, { scope: "row" }), make("td", words(task, pair)), make("td", mark(pair)), make("td", why));
      list.append(row);
    }
    const wrap = make("div", "", { class: "play-scroll", tabindex: "0", role: "region", "aria-label": "Picks" });
    wrap.append(list);
    const next = make("button", number + 1 < TASKS.length ? "Next task (Enter)" : "Play again (Enter)", { type: "button" });
    next.addEventListener("click", begin);
    answer.replaceChildren(wrap, next);
    setTimeout(() => next.focus());
  };

  const begin = () => {
    number += 1;
    if (number >= TASKS.length) {
      number = 0;
      Object.keys(wins).forEach((who) => (wins[who] = 0));
    }
    [picked, done] = [[], false];
    answer.replaceChildren();
    show();
    heading.focus();
  };

  document.addEventListener("keydown", (event) => {
    const inField = event.target.closest("input, textarea, [contenteditable]");
    if (inField || event.ctrlKey || event.altKey || event.metaKey || !KEYS.includes(event.key)) return;
    event.preventDefault();
    event.stopPropagation();
    pick(KEYS.indexOf(event.key));
  }, true);
  show();
})();
