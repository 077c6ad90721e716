// Rates and means with 95 % intervals.

const Z95 = 1.959963984540054;

/** Wilson's interval of a rate; null without trials. */
function wilson(successes, trials) {
  if (!trials) return null;
  const rate = successes / trials,
    share = (Z95 * Z95) / trials;
  const centre = (rate + share / 2) / (1 + share);
  const half = (Z95 / (1 + share)) * Math.sqrt((rate * (1 - rate)) / trials + share / (4 * trials));
  const low = successes === 0 ? 0 : Math.max(0, centre - half);
  const high = successes === trials ? 1 : Math.min(1, centre + half);
  return { rate, low, high };
}

/** Mean and 1.96 standard errors (null below two values); null without values. */
function mean(values) {
  if (!values.length) return null;
  const middle = values.reduce((sum, value) => sum + value, 0) / values.length;
  if (values.length < 2) return { mean: middle, error: null };
  const squares = values.reduce((sum, value) => sum + (value - middle) ** 2, 0);
  return { mean: middle, error: Z95 * Math.sqrt(squares / (values.length - 1) / values.length) };
}

/** Map of a key -> rows, in order of appearance. */
function grouped(rows, key) {
  const groups = new Map();
  for (const row of rows) {
    const value = key(row);
    if (!groups.has(value)) groups.set(value, []);
    groups.get(value).push(row);
  }
  return groups;
}
