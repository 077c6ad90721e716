// Rates with 95 % intervals; the same formulas as results/statistics.py.

const TAIL = 0.025;
const STEP = 0.125;
const STEPS = [...Array(104).keys()].map((step) => step * STEP);

/** Share of ones with its interval, from the ones and runs of each unit; null without runs. */
function rateOf(units) {
  const runs = units.reduce((sum, unit) => sum + unit.runs, 0);
  if (!runs) return null;
  const squares = units.reduce((sum, unit) => sum + unit.runs ** 2, 0);
  const weights = new Map();
  for (const unit of units) {
    const value = unit.ones / unit.runs;
    weights.set(value, (weights.get(value) ?? 0) + (unit.runs * runs) / squares);
  }
  const values = [...weights];
  return {
    rate: units.reduce((sum, unit) => sum + unit.ones, 0) / runs,
    low: 1 - upperEnd(values.map(([value, weight]) => [1 - value, weight])),
    high: upperEnd(values),
  };
}

/** Upper end of a mean of values from 0 to 1 with weights: of another unit it is 1 at most. */
function upperEnd(values) {
  const all = [...values, [1, 1]];
  let low = Math.min(...values.map(([value]) => value)),
    high = 1;
  for (let turn = 0; turn < 40 && high > low; turn++) {
    const middle = (low + high) / 2;
    if (above(all.map(([value, weight]) => [value - middle, weight])) > TAIL) low = middle;
    else high = middle;
  }
  return high;
}

/** Probability that a sum of Gamma(weight) variables times values is positive. */
function above(values) {
  const mean = values.reduce((sum, [value, weight]) => sum + value * weight, 0);
  if (values.every(([value]) => value >= 0)) return 1;
  return mean > 0
    ? 1 - integral(values.map(([value, weight]) => [-value, weight]))
    : integral(values);
}

/** The same where the mean of the sum is not positive: Mellin's integral through the saddle point. */
function integral(values) {
  const at = saddle(values);
  const terms = values.map(([value, weight]) => [value / (1 - at * value), weight, 1 - at * value]);
  const width = 1 / Math.sqrt(terms.reduce((sum, [x, weight]) => sum + weight * x * x, at ** -2));
  const start = terms.reduce((sum, [, weight, rest]) => sum - weight * Math.log(rest), 0);
  let total = 0;
  for (const step of STEPS) {
    const y = width * Math.sinh(step);
    let size = start,
      turn = 0;
    for (const [x, weight] of terms) {
      size -= 0.5 * weight * Math.log1p((x * y) ** 2);
      turn += weight * Math.atan(x * y);
    }
    const real = (Math.cos(turn) * at + Math.sin(turn) * y) / (at * at + y * y);
    total += Math.exp(size) * real * Math.cosh(step) * (step ? 1 : 0.5);
  }
  return (total * STEP * width) / Math.PI;
}

function saddle(values) {
  let low = 0,
    high = 1 / Math.max(...values.map(([value]) => value));
  for (let turn = 0; turn < 60; turn++) {
    const at = (low + high) / 2;
    const slope = values.reduce((sum, [x, weight]) => sum + (weight * x) / (1 - at * x), -1 / at);
    if (slope > 0) high = at;
    else low = at;
  }
  return (low + high) / 2;
}

/** Ones and runs of each situation: runs that differ in nothing but the seed repeat it. */
function unitsOf(rows, isOne) {
  const situation = (row) => row.run.slice(0, Math.max(row.run.lastIndexOf("--"), 0)) || row.run;
  return [...grouped(rows, situation).values()].map((group) => ({
    ones: group.filter(isOne).length,
    runs: group.length,
  }));
}

/** Mean of the values that there are, and of how many if some are missing. */
function meanOf(values) {
  const known = values.filter((value) => value !== null);
  if (!known.length) return "–";
  const mean = known.reduce((sum, value) => sum + value, 0) / known.length;
  return known.length === values.length
    ? mean.toFixed(1)
    : `${mean.toFixed(1)} (${known.length} of ${values.length})`;
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
