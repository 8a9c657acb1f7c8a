// A game on the tables of the test tasks: a person picks two items, then sees the answer, the agent's pair and its reason.
"use strict";
(() => {
  const root = document.getElementById("table-game");
  if (!root || typeof TASKS === "undefined") return;
  const KEYS = "1234567890";
  const ROUND = 10; // goals of a round
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
  const results = (task, pair) => task.made[[...pair].sort((a, b) => a - b).join(",")] || [];
  const wonBy = (task, pair) => results(task, pair).includes(task.goal);
  const words = (task, pair) => {
    const made = results(task, pair).join(", ") || "nothing";
    return `${pair.map((slot) => task.table[slot]).join(" + ")} → ${made}`;
  };
  const answer = (task) => {
    const pair = Object.keys(task.made).find((key) => task.made[key].includes(task.goal));
    return words(task, pair.split(",").map(Number));
  };
  const goals = (count) => `${count} goal${count === 1 ? "" : "s"}`;

  const heading = make("h2", "", { id: "goal", tabindex: "-1" });
  const score = make("p");
  const table = make("div", "", { class: "play-table", role: "group", "aria-label": "Items on the table" });
  const outcome = make("div", "", { "aria-live": "polite" });
  root.replaceChildren(heading, score, table, outcome);

  const inRound = () => number % ROUND;
  const isLast = () => inRound() === ROUND - 1 || number === TASKS.length - 1;

  const show = () => {
    const task = TASKS[number];
    heading.textContent = `Make: ${task.goal}`;
    const played = inRound() + (done ? 1 : 0);
    const tally = played ? ` So far you made ${goals(wins.you)}, the agent ${wins.agent}.` : "";
    score.textContent = `Goal ${inRound() + 1} of ${ROUND}.${tally}`;
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
    wins.you += wonBy(task, picked);
    wins.agent += wonBy(task, task.agent);
    const said = (who, pair) => `${who}: ${words(task, pair)}. ${wonBy(task, pair) ? "Goal made." : "Not the goal."}`;
    const because = task.because.length ? ` It knows ${task.because.slice(0, 2).join(" and ")}.` : "";
    const lines = [said("You", picked), said("Agent", task.agent) + because];
    if (!wonBy(task, picked)) lines.push(`The answer: ${answer(task)}.`);
    if (isLast()) {
      const lead = wins.you === wins.agent ? "A draw" : wins.you > wins.agent ? "You win" : "The agent wins";
      lines.push(`${lead}: you made ${goals(wins.you)} of ${inRound() + 1}, the agent ${wins.agent}.`);
    }
    const next = make("button", isLast() ? "Play another round (Enter)" : "Next goal (Enter)", { type: "button" });
    next.addEventListener("click", begin);
    outcome.replaceChildren(...lines.map((line) => make("p", line)), next);
    setTimeout(() => next.focus());
  };

  const begin = () => {
    if (isLast()) Object.keys(wins).forEach((who) => (wins[who] = 0));
    number = (number + 1) % TASKS.length;
    [picked, done] = [[], false];
    outcome.replaceChildren();
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
