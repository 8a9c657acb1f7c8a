"use strict";
// Conveniences only: without this script each page shows the same, and the search box leads to the list of entities.
(() => {
  const make = (tag, properties, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };

  // --- search: a combobox as the ARIA Authoring Practices describe it ---

  const form = document.querySelector("form.search");
  const input = form.querySelector("input");
  const list = make("ul", { id: "found", hidden: true });
  list.setAttribute("role", "listbox");
  list.setAttribute("aria-label", "Entities");
  for (const [name, value] of [["role", "combobox"], ["aria-controls", "found"], ["aria-expanded", "false"],
    ["aria-autocomplete", "list"]]) input.setAttribute(name, value);
  form.append(list);
  let chosen = -1;
  let asked = 0;

  const folded = (text) => text.trim().normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase();
  const rank = (name, text) => {
    if (name === text) return 0;
    if (name.startsWith(text)) return 1;
    return name.includes(` ${text}`) ? 2 : 3;
  };
  // A static site brings its entities in a file, the most used first; a server is asked.
  const inFile = async (text) => {
    if (!window.entities) {
      await new Promise((resolve, reject) => {
        document.head.append(make("script", { src: form.dataset.file, onload: resolve, onerror: reject }));
      });
    }
    return window.entities.filter(([label]) => folded(label).includes(text))
      .sort(([a], [b]) => rank(folded(a), text) - rank(folded(b), text)).slice(0, 10)
      .map(([label, file]) => [label, new URL(file, new URL(form.dataset.file, document.baseURI)).href]);
  };
  const onServer = async (text) => {
    const { entities } = await (await fetch(`${form.action}?q=${encodeURIComponent(text)}&format=json`)).json();
    // In the query, as some labels fit no path.
    return entities.slice(0, 10).map(({ entity }) => [entity, `/entity?entity=${encodeURIComponent(entity)}`]);
  };
  const find = form.dataset.file ? inFile : onServer;
  form.hidden = false;

  const choose = (number) => {
    chosen = number;
    [...list.children].forEach((item, i) => item.setAttribute("aria-selected", i === chosen));
    if (chosen >= 0) input.setAttribute("aria-activedescendant", `found-${chosen}`);
    else input.removeAttribute("aria-activedescendant");
  };
  const close = () => {
    asked++; // an answer on its way opens no list
    list.hidden = true;
    input.setAttribute("aria-expanded", "false");
    choose(-1);
  };
  const show = (found) => {
    list.replaceChildren(...found.map(([label, address], i) => {
      const item = make("li", { id: `found-${i}`, textContent: label });
      item.setAttribute("role", "option");
      item.dataset.address = address;
      item.addEventListener("mousedown", () => location.assign(address));
      return item;
    }));
    list.hidden = !found.length;
    input.setAttribute("aria-expanded", String(found.length > 0));
    choose(-1);
  };
  input.addEventListener("input", async () => {
    const text = folded(input.value);
    const number = ++asked;
    const found = text ? await find(text).catch(() => []) : [];
    if (number === asked) show(found); // answers may come in another order than questions
  });
  input.addEventListener("keydown", (event) => {
    const items = list.children;
    if (event.key === "Escape") {
      close();
    } else if ((event.key === "ArrowDown" || event.key === "ArrowUp") && items.length && !list.hidden) {
      event.preventDefault();
      choose((chosen + (event.key === "ArrowDown" ? 1 : items.length - 1) + (chosen < 0 && event.key === "ArrowUp" ? 1 : 0)) % items.length);
    } else if (event.key === "Enter" && (chosen >= 0 || form.dataset.file) && items.length && !list.hidden) {
      event.preventDefault();
      location.assign(items[Math.max(chosen, 0)].dataset.address);
    }
  });
  input.addEventListener("blur", close);
  form.addEventListener("submit", (event) => form.dataset.file && event.preventDefault());
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("input, select, textarea, [contenteditable]");
    if (event.key === "/" && !isTyping && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      input.focus();
      input.select();
    }
  });

  // --- choices of a page take effect at once, and leave no empty names in the address ---

  const go = (filters) => {
    const query = [...new FormData(filters)].filter(([, value]) => value !== "");
    const address = new URL(filters.action);
    address.search = new URLSearchParams(query).toString();
    location.assign(address);
  };
  for (const filters of document.querySelectorAll("form.filters")) {
    filters.addEventListener("change", (event) => event.target.matches("select, input[type=checkbox]") && go(filters));
    filters.addEventListener("submit", (event) => {
      event.preventDefault();
      go(filters);
    });
  }

  // Going back, browsers fill in what was chosen last, and not what the page shows.
  addEventListener("pageshow", () => document.querySelectorAll("form.filters").forEach((filters) => filters.reset()));

  // --- ticked suggestions become a file, without a server ---

  const suggestions = document.getElementById("suggestions");
  if (suggestions) {
    const save = document.getElementById("save");
    const ticked = () => [...suggestions.querySelectorAll("input:checked")];
    const count = () => {
      const number = ticked().length;
      save.disabled = !number;
      document.getElementById("ticks").textContent = number ? `${number} ticked` : "";
    };
    save.hidden = false;
    suggestions.addEventListener("change", count);
    save.addEventListener("click", () => {
      // A line ends with the empty cell for the tick.
      const lines = [suggestions.dataset.header, ...ticked().map((box) => `${box.dataset.line}x`)];
      const file = new Blob([lines.map((line) => `${line}\n`).join("")], { type: "text/csv" });
      const address = URL.createObjectURL(file);
      make("a", { href: address, download: "suggestions.csv" }).click();
      setTimeout(() => URL.revokeObjectURL(address));
    });
    count(); // a page that is shown again may keep its ticks
  }

  // --- what changes while it is looked at ---

  const renew = async () => {
    const page = await fetch(location.href, { cache: "no-store" });
    const fresh = new DOMParser().parseFromString(await page.text(), "text/html");
    const [olds, news] = [document, fresh].map((one) => [...one.querySelectorAll("[data-live]")]);
    olds.forEach((old, i) => news[i] && !old.contains(document.activeElement) && old.replaceChildren(...news[i].childNodes));
    // A section that no longer changes comes without the mark.
    if (news.length < olds.length) location.reload();
  };
  const live = document.querySelector("[data-live]");
  if (live && location.protocol.startsWith("http")) {
    const again = async () => {
      if (!document.hidden) await renew().catch(() => {});
      setTimeout(again, 1000 * Number(live.dataset.live));
    };
    setTimeout(again, 1000 * Number(live.dataset.live));
  }
})();
