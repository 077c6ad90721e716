// Texts of packing.py -> values.

/** JSON values of a deflated base-64 text. */
async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).json();
}

/** Values of `steady`: the running sum of the running sum, times the unit. */
function restored(differences, unit) {
  let slope = 0,
    value = 0;
  return differences.map((difference) => {
    slope += difference;
    value += slope;
    return value * unit;
  });
}

/** Values of `stepwise`: the running sum, times the unit. */
function summed(differences, unit) {
  let value = 0;
  return differences.map((difference) => {
    value += difference;
    return value * unit;
  });
}

/** What the page holds under an id, or null. */
function stored(id) {
  const element = document.getElementById(id);
  return element ? element.textContent : null;
}
