// Tables that their headings sort.

const PAGE_ROWS = 200;

/** Objects with a value per column, numbered, from lists of values. */
function rowsOf(names, lists) {
  return lists.map((values, number) => ({
    number,
    ...Object.fromEntries(names.map((name, place) => [name, values[place]])),
  }));
}

/** Order of two values; rows without a value come last in both directions. */
function compared(one, other, down = false) {
  if (one === other) return 0;
  if (one === null) return 1;
  if (other === null) return -1;
  const order =
    typeof one === "number" && typeof other === "number"
      ? one - other
      : String(one).localeCompare(String(other), "en", { numeric: true });
  return down ? -order : order;
}

/** A table with an id; a button below it shows more rows. */
class SortedTable {
  /** `show` shows the page again, `cell` makes the cells that are not plain values, else null. */
  constructor(id, show, cell, sort = { name: null, down: false }) {
    Object.assign(this, { id, show, cell, sort, most: PAGE_ROWS });
    byId(`${id}-more`).addEventListener("click", () => {
      this.most += PAGE_ROWS;
      show();
    });
  }

  sorted(rows) {
    const { name, down } = this.sort;
    return name ? [...rows].sort((one, other) => compared(one[name], other[name], down)) : rows;
  }

  /** `attributes` of a row's element. */
  fill(columns, rows, attributes = () => ({})) {
    const body = rows
      .slice(0, this.most)
      .map((row) =>
        make(
          "tr",
          attributes(row),
          ...columns.map((column) => this.cell(row, column) ?? plainCell(row, column)),
        ),
      );
    const head = make("tr", {}, ...columns.map((column) => this.heading(column)));
    byId(this.id).replaceChildren(make("thead", {}, head), make("tbody", {}, ...body));
    const more = byId(`${this.id}-more`),
      left = rows.length - this.most;
    more.hidden = left <= 0;
    more.textContent = `Show ${Math.min(PAGE_ROWS, left)} more`;
  }

  heading(column) {
    const { name, down } = this.sort,
      here = name === column.name;
    return make(
      "th",
      {
        scope: "col",
        "aria-sort": here ? (down ? "descending" : "ascending") : "none",
        class: isNumber(column) ? "number" : null,
      },
      make(
        "button",
        { type: "button", "data-name": column.name, onclick: () => this.sortBy(column) },
        `${column.heading}${here ? (down ? " ▼" : " ▲") : ""}`,
      ),
    );
  }

  sortBy({ name, ascending = true }) {
    this.sort = { name, down: this.sort.name === name ? !this.sort.down : !ascending };
    this.show();
    byId(this.id).querySelector(`th button[data-name="${name}"]`)?.focus();
  }
}

function isNumber({ kind }) {
  return kind === "number" || kind === "share";
}

function plainCell(row, column) {
  const value = row[column.name],
    label = { "data-label": column.heading };
  if (isNumber(column))
    return make(
      "td",
      { class: value === null ? "number none" : "number", ...label },
      numberText(row, column),
    );
  if (column.kind === "flag")
    return make("td", label, value === null ? "" : value >= 1 ? "yes" : "no");
  return make("td", label, value ?? "");
}

/** A number or a share; with its interval, where the row has one. */
function numberText(row, { name, kind, digits: places = 0 }) {
  const share = kind === "share",
    unit = share ? " %" : "";
  const shown = (value) => fixed(share ? 100 * value : value, places);
  const [value, low, high] = [name, `${name}_lo`, `${name}_hi`].map((one) => row[one] ?? null);
  if (value === null) return "–";
  const interval = low === null || high === null ? "" : ` (${shown(low)} to ${shown(high)}${unit})`;
  return `${shown(value)}${unit}${interval}`;
}
