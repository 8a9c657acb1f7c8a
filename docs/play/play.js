// The website's games: a person picks two items for a goal, then sees what they make and, after a loss, the answer.
// TASKS, of the page Play, also have an agent's pair and its reason; FRONT_TASKS, of the landing page, have neither.
"use strict";
(() => {
  const front = document.getElementById("front-game");
  const root = front || document.getElementById("table-game");
  const tasks = front && typeof FRONT_TASKS !== "undefined" ? FRONT_TASKS : typeof TASKS !== "undefined" ? TASKS : [];
  if (!root || !tasks.length) return;
  const KEYS = "1234567890";
  const ROUND = Math.min(10, tasks.length); // goals of a round
  const wins = { you: 0, agent: 0 };
  let number = 0;
  let picked = [];
  let done = false;

  const make = (tag, text = "", attributes = {}) => {
    const element = document.createElement(tag);
    element.textContent = text;
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    return element;
  };
  const drawing = (path) => {
    const picture = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    picture.setAttribute("viewBox", "0 0 24 24");
    const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
    line.setAttribute("d", path);
    picture.append(line);
    return picture;
  };
  const pair = (task, slots) => slots.map((slot) => task.table[slot]).join(" + ");
  const results = (task, slots) => task.made[[...slots].sort((a, b) => a - b).join(",")] || [];
  const wonBy = (task, slots) => results(task, slots).includes(task.goal);
  const words = (task, slots) => `${pair(task, slots)} → ${results(task, slots).join(", ") || "nothing"}`;
  const answer = (task) => {
    const key = Object.keys(task.made).find((slots) => task.made[slots].includes(task.goal));
    return words(task, key.split(",").map(Number));
  };
  const goals = (count) => `${count} goal${count === 1 ? "" : "s"}`;
  // Why the agent chose its pair, in a sentence.
  const reason = (task) => {
    if (task.because.length) return `It knows similar recipes: ${task.because.slice(0, 2).join(" and ")}.`;
    return `It saw no similar recipe for this pair, and the scorer's first choice was ${pair(task, task.scorer)}.`;
  };

  const heading = make(front ? "p" : "h2", "", { id: "goal", class: "play-goal", tabindex: "-1" });
  const score = make("p", "", { class: "play-score" });
  const table = make("div", "", { class: "play-table", role: "group", "aria-label": "Items on the table" });
  const outcome = make("div", "", { class: "play-outcome", "aria-live": "polite" });
  root.replaceChildren(heading, score, table, outcome);

  const inRound = () => number % ROUND;
  const isLast = () => inRound() === ROUND - 1 || number === tasks.length - 1;

  const show = () => {
    const task = tasks[number];
    heading.textContent = `Make: ${task.goal}`;
    const played = inRound() + (done ? 1 : 0);
    const tally = played ? ` You made ${goals(wins.you)}, the agent ${wins.agent}.` : "";
    score.textContent = front ? "Pick the two things that make it." : `Goal ${inRound() + 1} of ${ROUND}.${tally}`;
    table.replaceChildren(
      ...task.table.map((item, slot) => {
        const button = make("button", "", { type: "button", "aria-pressed": picked.includes(slot) });
        const mark = make("span", task.icons ? "" : KEYS[slot] || "", { "aria-hidden": "true", class: "play-mark" });
        if (task.icons) mark.append(drawing(task.icons[slot]));
        button.append(mark, make("span", item));
        button.disabled = done;
        button.addEventListener("click", () => pick(slot));
        return button;
      }),
    );
  };

  const pick = (slot) => {
    if (done || slot >= tasks[number].table.length) return;
    picked.push(slot);
    if (picked.length === 2) finish();
    show();
    if (!done) table.children[slot].focus();
  };

  const finish = () => {
    const task = tasks[number];
    const won = wonBy(task, picked);
    done = true;
    wins.you += won;
    const said = (who, slots) => `${who}: ${words(task, slots)}. ${wonBy(task, slots) ? "Goal made." : "Not the goal."}`;
    const lines = [said("You", picked)];
    if (!won) lines.push(`The answer: ${answer(task)}.`);
    if (task.agent) {
      wins.agent += wonBy(task, task.agent);
      lines.splice(1, 0, `${said("Agent", task.agent)} ${reason(task)}`);
      if (isLast()) {
        const lead = wins.you === wins.agent ? "A draw" : wins.you > wins.agent ? "You win" : "The agent wins";
        lines.push(`${lead}: you made ${goals(wins.you)} of ${inRound() + 1}, the agent ${wins.agent}.`);
      }
    }
    const again = task.agent ? "Play another round" : "Play again";
    const next = make("button", isLast() ? again : "Next goal", { type: "button", class: "play-next" });
    next.addEventListener("click", begin);
    outcome.replaceChildren(...lines.map((line) => make("p", line)), next);
    outcome.classList.toggle("play-won", won);
    setTimeout(() => next.focus({ preventScroll: true }));
  };

  const begin = () => {
    if (isLast()) Object.keys(wins).forEach((who) => (wins[who] = 0));
    number = (number + 1) % tasks.length;
    [picked, done] = [[], false];
    outcome.replaceChildren();
    show();
    heading.focus({ preventScroll: true });
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
