// What axe misses in the theme: a name for the search, and wide tables that scroll with the keyboard.
addEventListener("load", () => {
  document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
  setTimeout(() => {
    for (const table of document.querySelectorAll(".md-typeset__scrollwrap")) table.tabIndex = 0;
  });
});
// Tables with bars sort by a click on a heading, or Enter; numbers come first, highest on top.
addEventListener("load", () => {
  for (const table of document.querySelectorAll("table:has(.bar)")) {
    const heads = [...table.querySelectorAll("th")];
    heads.forEach((head, column) => {
      head.tabIndex = 0;
      head.setAttribute("aria-sort", "none");
      const sort = () => {
        const turn = head.getAttribute("aria-sort") === "descending" ? 1 : -1;
        for (const other of heads) other.setAttribute("aria-sort", "none");
        head.setAttribute("aria-sort", turn < 0 ? "descending" : "ascending");
        const key = (row) => row.cells[column].textContent.trim();
        const compare = (a, b) => parseFloat(key(a)) - parseFloat(key(b)) || key(a).localeCompare(key(b));
        const rows = [...table.tBodies[0].rows].sort((a, b) => turn * compare(a, b));
        table.tBodies[0].append(...rows);
      };
      head.addEventListener("click", sort);
      head.addEventListener("keydown", (event) => event.key === "Enter" && sort());
    });
  }
});
