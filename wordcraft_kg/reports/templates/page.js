"use strict";
// Conveniences only: without this script the page shows the same tables and pictures.
(() => {
  const textOf = (cell) => cell.textContent.replace(/\s+/g, " ").trim();
  const make = (tag, properties, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };

  // A number that a cell begins with; the interval or unit after it does not count.
  const numberOf = (text) => {
    const found = text.replace(/,/g, "").replace("−", "-").match(/^[-+]?\d*\.?\d+/);
    return found ? Number(found[0]) : null;
  };

  const compare = (a, b) => {
    const [x, y] = [numberOf(a), numberOf(b)];
    if (x !== null && y !== null) return x - y;
    return (x === null) - (y === null) || a.localeCompare(b);
  };

  const sortBy = (table, head) => {
    const column = [...head.parentNode.cells].indexOf(head);
    const order = head.getAttribute("aria-sort") === "descending" ? "ascending" : "descending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", order);
    const sign = order === "ascending" ? 1 : -1;
    // Each group of rows is sorted for itself.
    for (const body of table.tBodies) {
      const rows = [...body.rows].filter((row) => row.className !== "group");
      const key = (row) => (row.cells[column] ? textOf(row.cells[column]) : "");
      rows.sort((a, b) => sign * compare(key(a), key(b))).forEach((row) => body.append(row));
    }
  };

  const cellsOf = (table) =>
    [...table.rows].filter((row) => !row.hidden).map((row) => [...row.cells].map(textOf));

  const asMarkdown = (table) => {
    const [head, ...rows] = cellsOf(table);
    const line = (cells) => `| ${cells.map((cell) => cell.replace(/\|/g, "\\|")).join(" | ")} |`;
    return [line(head), line(head.map((_, i) => (i ? "---:" : "---"))), ...rows.map(line)].join("\n");
  };

  const asLatex = (table) => {
    const named = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}" };
    const escape = (text) => text.replace(/[\\~^&%$#_{}]/g, (letter) => named[letter] || `\\${letter}`);
    const [head, ...rows] = cellsOf(table).map((cells) => `${cells.map(escape).join(" & ")} \\\\`);
    const columns = `l${"r".repeat(table.rows[0].cells.length - 1)}`;
    return [`\\begin{tabular}{${columns}}`, "\\toprule", head, "\\midrule", ...rows, "\\bottomrule", "\\end{tabular}"]
      .join("\n");
  };

  const copy = async (button, text) => {
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Pages opened from a disk may not have the clipboard.
      const area = make("textarea", { value: text });
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    const before = button.textContent;
    button.textContent = "copied";
    setTimeout(() => (button.textContent = before), 1200);
  };

  const equip = (table) => {
    if (!table.tHead || table.rows.length < 3) return;
    const heads = [...table.tHead.rows[0].cells];
    for (const head of heads) {
      const button = make("button", { type: "button" }, ...head.childNodes);
      button.addEventListener("click", () => sortBy(table, head));
      head.append(button);
    }
    const tools = make("div", { className: "tools" });
    for (const [name, write] of [["Copy as Markdown", asMarkdown], ["Copy as LaTeX", asLatex]]) {
      const button = make("button", { type: "button", textContent: name });
      button.addEventListener("click", () => copy(button, write(table)));
      tools.append(button);
    }
    (table.closest(".scroll") || table).after(tools);
  };
  document.querySelectorAll(".scroll > table").forEach(equip);

  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("details:not([open])")];
    closed.forEach((details) => (details.open = true));
  });
  addEventListener("afterprint", () => closed.forEach((details) => (details.open = false)));
})();
