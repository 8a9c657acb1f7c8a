"use strict";
// Moves and zooms the map, names more dots where there is room, and shows the links of the dot under the pointer.
// Without this script the map shows all dots, and each is a link.
(() => {
  const svg = document.querySelector("svg.world");
  if (!svg?.querySelector("circle")) return;
  const NS = "http://www.w3.org/2000/svg";
  const view = svg.querySelector(".view");
  const whole = svg.viewBox.baseVal;
  const nodes = [...view.querySelectorAll(".dots > *")].map((element, number) => {
    const circle = element.querySelector("circle");
    const [x, y] = ["cx", "cy"].map((name) => Number(circle.getAttribute(name)));
    return { element, number, x, y, letters: element.querySelector("text").textContent.length };
  });
  const CLOSEST = 12; // how far one can zoom in
  const STEP = 1.4; // of the buttons and keys
  const SHIFT = 60; // pixels that an arrow key moves the map
  const LETTER = 6; // pixels
  const LINE = 13;

  // --- what is seen: the map is drawn `zoom` times as large, its point (0, 0) at (left, top) of the picture ---

  const now = { zoom: 1, left: 0, top: 0 };
  const unit = () => {
    const box = svg.getBoundingClientRect();
    return Math.max(whole.width / box.width, whole.height / box.height) || 1; // units of the picture in a pixel
  };
  let due = 0;
  const draw = () => {
    due = 0;
    view.setAttribute("transform", `translate(${now.left.toFixed(1)} ${now.top.toFixed(1)}) scale(${now.zoom.toFixed(4)})`);
  };
  const redraw = () => {
    due ||= requestAnimationFrame(draw);
  };
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const hold = () => {
    // The middle of the picture stays on the map.
    const [middle, centre] = [whole.x + whole.width / 2, whole.y + whole.height / 2];
    now.left = clamp(now.left, middle - now.zoom * (whole.x + whole.width), middle - now.zoom * whole.x);
    now.top = clamp(now.top, centre - now.zoom * (whole.y + whole.height), centre - now.zoom * whole.y);
  };
  const move = (x, y) => {
    now.left += x;
    now.top += y;
    hold();
    redraw();
    later();
  };
  const zoomAt = (x, y, factor) => {
    const zoom = clamp(now.zoom * factor, 1, CLOSEST);
    if (zoom === now.zoom) return false;
    now.left = x - (x - now.left) * (zoom / now.zoom);
    now.top = y - (y - now.top) * (zoom / now.zoom);
    now.zoom = zoom;
    if (zoom === 1) now.left = now.top = 0;
    hold();
    redraw();
    later();
    return true;
  };
  const zoom = (factor) => zoomAt(whole.x + whole.width / 2, whole.y + whole.height / 2, factor);
  const all = () => {
    Object.assign(now, { zoom: 1, left: 0, top: 0 });
    redraw();
    later();
  };
  const inPicture = (event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return [point.x, point.y];
  };

  // --- names: as many as there is room for, those of the most used first, in letters of the same size ---

  const regions = [...view.querySelectorAll(".regions text")];
  const isNear = (node) => node.element.matches(".near, .chosen");
  const first = [...nodes].sort((one, other) => isNear(other) - isNear(one));
  const name = () => {
    const pixel = unit() / now.zoom; // units of the map in a pixel
    // Dots grow with the zoom, but more slowly; on a small screen they are smaller, or they would hide each other.
    svg.style.setProperty("--u", (Math.min(pixel, 4 / now.zoom) * Math.min(now.zoom ** 0.35, 2)).toFixed(3));
    svg.style.setProperty("--letter", pixel.toFixed(3));
    const [right, bottom] = [whole.x + whole.width, whole.y + whole.height];
    const taken = new Map();
    const isTaken = (start, end, line, row) => [row - 1, row, row + 1].some(
      (near) => (taken.get(near) || []).some(([left, to, at]) => start < to && end > left && Math.abs(line - at) < LINE),
    );
    const take = (start, end, line, row) => taken.set(row, [...(taken.get(row) || []), [start, end, line]]);
    // The names of groups come first, the largest group's before all; where two meet, the smaller group has none.
    for (const region of regions) {
      region.style.display = "";
      const { x, y, width, height } = region.getBBox();
      const [start, end] = [x, x + width].map((edge) => (edge * now.zoom + now.left) / unitNow);
      const [top, low] = [y, y + height].map((edge) => (edge * now.zoom + now.top) / unitNow);
      const lines = Array.from({ length: Math.ceil((low - top) / LINE) }, (_, i) => top + (i + 0.5) * LINE);
      const isHidden = lines.some((line) => isTaken(start, end, line, Math.floor(line / LINE)));
      if (isHidden) region.style.display = "none";
      else for (const line of lines) take(start, end, line, Math.floor(line / LINE));
    }
    for (const node of first) {
      const [x, y] = [node.x * now.zoom + now.left, node.y * now.zoom + now.top];
      const start = x / unitNow, end = start + 14 + LETTER * node.letters, line = y / unitNow, row = Math.floor(line / LINE);
      const isIn = x >= whole.x && x <= right && y >= whole.y && y <= bottom;
      const fits = isIn && !isTaken(start - 8, end, line, row);
      if (fits) take(start - 8, end, line, row);
      if (fits === node.isFar || node.isFar === undefined) {
        node.isFar = !fits;
        node.element.classList.toggle("far", !fits);
      }
    }
  };
  let unitNow = 1;
  let waiting = 0;
  const later = () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      unitNow = unit();
      name();
    }, 120);
  };

  // --- links of the dot under the pointer, or of the one that has the focus ---

  const links = JSON.parse(document.querySelector(".world-links").textContent);
  const partners = nodes.map(() => ({ combines: [], makes: [], "made-of": [] }));
  links.combines.forEach((others, one) => others.forEach((other) => {
    partners[one].combines.push(other);
    partners[other].combines.push(one);
  }));
  links.components.forEach((results, part) => results.forEach((made) => {
    partners[part].makes.push(made);
    partners[made]["made-of"].push(part);
  }));
  const shown = document.createElementNS(NS, "g");
  view.querySelector(".links").after(shown);
  const showLinks = (node) => {
    shown.replaceChildren(...Object.entries(node ? partners[node.number] : {}).filter(([, ends]) => ends.length).map(([kind, ends]) => {
      const path = document.createElementNS(NS, "path");
      path.setAttribute("class", kind);
      path.setAttribute("d", ends.map((end) => `M${node.x} ${node.y}L${nodes[end].x} ${nodes[end].y}`).join(""));
      return path;
    }));
    svg.classList.toggle("shows-links", Boolean(node));
  };
  const nodeOf = (target) => {
    const element = target.closest?.(".dots > *");
    return element ? nodes.find((node) => node.element === element) : undefined;
  };
  let hovered;
  const hover = (node) => {
    if (node === hovered) return;
    hovered = node;
    showLinks(node);
  };
  svg.addEventListener("pointerover", (event) => !pointers.size && hover(nodeOf(event.target)));
  svg.addEventListener("pointerleave", () => hover(undefined));
  svg.addEventListener("focusin", (event) => hover(nodeOf(event.target)));
  svg.addEventListener("focusout", () => hover(undefined));

  // --- pointers: one drags the map, two zoom it ---

  const pointers = new Map();
  let dragged = 0;
  svg.addEventListener("dragstart", (event) => event.preventDefault());
  svg.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    if (!pointers.size) dragged = 0;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  svg.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const [x, y] = [event.clientX, event.clientY];
    dragged += Math.abs(x - last[0]) + Math.abs(y - last[1]);
    if (dragged > 4 && !svg.hasPointerCapture(event.pointerId)) {
      svg.setPointerCapture(event.pointerId);
      svg.classList.add("moving");
      hover(undefined);
    }
    pointers.set(event.pointerId, [x, y]);
    if (dragged <= 4) return;
    if (pointers.size === 1) {
      unitNow ||= unit();
      move((x - last[0]) * unitNow, (y - last[1]) * unitNow);
    } else {
      const [[otherX, otherY]] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const before = Math.hypot(last[0] - otherX, last[1] - otherY);
      const middle = { clientX: (x + otherX) / 2, clientY: (y + otherY) / 2 };
      zoomAt(...inPicture(middle), Math.hypot(x - otherX, y - otherY) / (before || 1));
    }
  });
  for (const end of ["pointerup", "pointercancel"]) {
    svg.addEventListener(end, (event) => {
      pointers.delete(event.pointerId);
      if (!pointers.size) svg.classList.remove("moving");
    });
  }
  // A link at which a drag ends was not meant.
  svg.addEventListener("click", (event) => dragged > 4 && event.preventDefault(), true);
  svg.addEventListener("wheel", (event) => {
    // Where there is nothing more to zoom out of, the page scrolls.
    const pixels = event.deltaY * [1, 16, 100][event.deltaMode];
    if (zoomAt(...inPicture(event), Math.exp(-clamp(pixels, -200, 200) / 300)) || pixels < 0) event.preventDefault();
  }, { passive: false });

  // --- keys: the map moves and zooms; from a dot, arrows lead to the next one in their direction ---

  const ARROWS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const KEYS = { "+": () => zoom(STEP), "=": () => zoom(STEP), "-": () => zoom(1 / STEP), 0: all, Home: all };
  let stop; // the one dot that Tab leads to
  const leadTo = (node) => {
    stop?.element.setAttribute("tabindex", "-1");
    stop = node;
    node.element.setAttribute("tabindex", "0");
  };
  const nextTo = (node, [left, up]) => {
    let best, least = Infinity;
    for (const other of nodes) {
      const along = (node.x - other.x) * left + (node.y - other.y) * up;
      const aside = Math.abs((node.x - other.x) * up) + Math.abs((node.y - other.y) * left);
      const far = along + 2 * aside;
      if (along > 0 && far < least) [best, least] = [other, far];
    }
    return best;
  };
  const bringIn = (node) => {
    const [x, y] = [node.x * now.zoom + now.left, node.y * now.zoom + now.top];
    const isIn = x >= whole.x && x <= whole.x + whole.width && y >= whole.y && y <= whole.y + whole.height;
    if (!isIn) move(whole.x + whole.width / 2 - x, whole.y + whole.height / 2 - y);
  };
  svg.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const node = nodeOf(event.target);
    const arrow = ARROWS[event.key];
    if (arrow && node) {
      const next = nextTo(node, arrow);
      if (next) {
        leadTo(next);
        next.element.focus({ preventScroll: true });
        bringIn(next);
      }
    } else if (arrow) {
      move(...arrow.map((direction) => direction * SHIFT * unit()));
    } else if (KEYS[event.key]) {
      KEYS[event.key]();
    } else return;
    event.preventDefault();
  });

  // --- begin ---

  for (const { element } of nodes) element.setAttribute("tabindex", "-1");
  leadTo(nodes.find(({ element }) => element.matches(".chosen")) || nodes[0]);
  svg.setAttribute("tabindex", "0");
  svg.setAttribute("aria-label", `${svg.getAttribute("aria-label")}; arrow keys move it, plus and minus zoom, 0 shows all`);
  svg.classList.add("moves");
  const region = svg.closest(".scroll");
  region?.removeAttribute("tabindex"); // there is nothing left to scroll
  const tools = document.createElement("div");
  tools.className = "map-tools";
  for (const [text, label, act] of [["+", "Zoom in", () => zoom(STEP)], ["−", "Zoom out", () => zoom(1 / STEP)], ["⤢", "Whole map", all]]) {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: text, title: label });
    button.setAttribute("aria-label", label);
    button.addEventListener("click", act);
    tools.append(button);
  }
  svg.closest(".map-card").prepend(tools);
  new ResizeObserver(later).observe(svg);
  unitNow = unit();
  name();
})();
