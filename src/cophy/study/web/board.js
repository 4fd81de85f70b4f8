// The image of C with marks. The mark of each object has its own shape, and the object's colour.

const SVG = "http://www.w3.org/2000/svg";
const RADIUS = 11;
// one shape per place in the list of objects, so that colours are never needed to tell marks apart
const CORNERS = [null, 4, 3, 5, 6, 8];

function element(name, attributes, parent) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  parent?.append(node);
  return node;
}

// The outline of the shape number `index`, around (0, 0).
function outline(index, attributes, parent) {
  const corners = CORNERS[index % CORNERS.length];
  if (corners === null) return element("circle", { r: RADIUS, ...attributes }, parent);
  const points = Array.from({ length: corners }, (_, corner) => {
    const angle = 2 * Math.PI * corner / corners - Math.PI / 2 + (corners === 4 ? Math.PI / 4 : 0);
    return `${(1.25 * RADIUS * Math.cos(angle)).toFixed(1)},${(1.25 * RADIUS * Math.sin(angle)).toFixed(1)}`;
  });
  return element("polygon", { points: points.join(" "), ...attributes }, parent);
}

// A mark: shape in the object's colour, between white and black lines that show on any ground.
export function mark(object, index) {
  const group = element("g", { class: "mark" });
  outline(index, { class: "mark-back" }, group);
  outline(index, { class: "mark-line" }, group).style.stroke = object.color;
  element("circle", { r: 2, class: "mark-middle" }, group);
  return group;
}

// The same as a small image, for lists and sentences.
export function icon(object, index) {
  const picture = element("svg", { viewBox: "-18 -18 36 36", class: "icon", "aria-hidden": "true" });
  picture.append(mark(object, index));
  return picture;
}

export class Board {
  // image: of C, loaded
  constructor(parent, task, image) {
    this.size = task.resolution;
    parent.append(image);
    this.svg = element("svg", {
      viewBox: `0 0 ${this.size} ${this.size}`, class: "board", role: "application", tabindex: "0",
      "aria-label": "Picture. Arrow keys move the cross, Enter sets it, Backspace takes back.",
    }, parent);
    this.names = element("g", { class: "names", visibility: "hidden" }, this.svg);
    this.lines = element("g", {}, this.svg);
    this.marks = element("g", {}, this.svg);
    this.cross = element("g", { class: "cross", visibility: "hidden" }, this.svg);
    for (const line of ["cross-back", "cross-line"]) element("path", { d: "M-16 0H16M0 -16V16", class: line }, this.cross);
    for (const object of task.objects) this.#name(object);
  }

  #name(object) {
    const [x, y] = object.at;
    const text = element("text", { x, y, class: "name" }, this.names);
    text.textContent = object.name;
  }

  showNames(shown) {
    this.names.setAttribute("visibility", shown ? "visible" : "hidden");
  }

  showCross(at) {
    this.cross.setAttribute("visibility", at ? "visible" : "hidden");
    if (at) this.cross.setAttribute("transform", `translate(${at.x} ${at.y})`);
  }

  // Redraws every click. clicks: slot -> {x, y}
  draw(objects, clicks) {
    this.marks.replaceChildren();
    objects.forEach((object, index) => {
      if (clicks.has(object.slot)) this.#place(mark(object, index), clicks.get(object.slot));
    });
  }

  // The right answer: a large circle where each object ended, and a line from the click to it.
  drawEnds(objects, clicks, ends) {
    objects.forEach((object) => {
      const [x, y] = ends[object.slot];
      for (const kind of ["end-back", "end-line"]) {
        const circle = element("circle", { cx: x, cy: y, r: 18, class: kind }, this.lines);
        if (kind === "end-line") circle.style.stroke = object.color;
      }
      const click = clicks.get(object.slot);
      if (click) element("line", { x1: click.x, y1: click.y, x2: x, y2: y, class: "way" }, this.lines);
    });
  }

  #place(group, { x, y }) {
    group.setAttribute("transform", `translate(${x} ${y})`);
    this.marks.append(group);
  }

  // Pixels of the picture where a pointer is, or null outside.
  at(event) {
    const box = this.svg.getBoundingClientRect();
    const x = (event.clientX - box.left) * this.size / box.width;
    const y = (event.clientY - box.top) * this.size / box.height;
    const inside = x >= 0 && y >= 0 && x <= this.size && y <= this.size;
    return inside ? { x: Math.round(10 * x) / 10, y: Math.round(10 * y) / 10 } : null;
  }
}
