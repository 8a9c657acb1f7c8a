"use strict";
// Conveniences only: without this script everything works by click, Tab and Enter.
(() => {
  const slots = [...document.querySelectorAll(".table button")];
  const press = (element) => {
    if (element) {
      element.focus();
      element.click();
    }
  };
  // Each page takes one selection: a further key press before the next page loads would select another first item.
  let isSent = false;
  document.addEventListener("submit", (event) => {
    if (isSent) event.preventDefault();
    isSent = true;
  });
  // The second half of a double click may reach the next page and select the same item again.
  document.addEventListener("click", (event) => {
    const isByPointer = event.detail > 0;
    if (isByPointer && event.target.closest(".selected") && performance.now() < 400) event.preventDefault();
  });
  addEventListener("pageshow", () => { isSent = false; }); // also after the back button
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || event.target.closest("input")) return;
    // The tenth item has the key 0; further items are reached by Tab.
    if (/^[0-9]$/.test(event.key)) press(slots[(Number(event.key) + 9) % 10]);
    else if (event.key === "Escape") press(document.querySelector(".undo"));
    else if (event.key === "Enter" && event.target === document.body) press(document.querySelector(".next"));
  });
})();
