// Elements of the page; texts only ever become text.

const SVG = "http://www.w3.org/2000/svg";

/** An element with attributes (`on` + event for listeners) and children, texts among them. */
function make(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/** The same for drawings. */
function drawn(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (typeof value === "boolean") element.toggleAttribute(name, value);
    else if (value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function byId(id) {
  return document.getElementById(id);
}

/** A number with `digits` decimal places; a dash where there is none. */
function fixed(value, digits) {
  return value === null || value === undefined ? "–" : value.toFixed(digits);
}

/** A share from 0 to 1 in per cent. */
function percent(share) {
  return `${(100 * share).toFixed(0)} %`;
}

/** A number with three significant digits. */
function digits(value) {
  return String(Number(value.toPrecision(3)));
}

/** A drop-down list of values; `labels` are their names. */
function choice(values, selected, onchange, labels = (value) => value) {
  const options = values.map((value) =>
    make("option", { value, selected: value === selected }, labels(value)),
  );
  return make("select", { onchange: (event) => onchange(event.target.value) }, ...options);
}

/** A table from headings and rows of texts or elements; `numbers` are columns set to the right. */
function tableOf(headings, rows, numbers = []) {
  const look = (column) => (numbers.includes(column) ? { class: "number" } : {});
  return [
    make(
      "thead",
      {},
      make(
        "tr",
        {},
        ...headings.map((heading, column) =>
          make("th", { scope: "col", ...look(column) }, heading),
        ),
      ),
    ),
    make(
      "tbody",
      {},
      ...rows.map((row) =>
        make("tr", {}, ...row.map((cell, column) => make("td", { ...look(column), "data-label": headings[column] }, cell))),
      ),
    ),
  ];
}

/** Paragraphs of an element: notices, one per text. */
function showTexts(id, texts) {
  byId(id).replaceChildren(...texts.map((text) => make("p", { class: "notice" }, text)));
}

/** "1 attack", "2 attacks"; `many` is another plural. */
function counted(number, one, many = `${one}s`) {
  return `${number} ${number === 1 ? one : many}`;
}
