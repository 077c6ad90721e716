// Several opponents, together or in turn: when each attacked, and how that ended.

/** A table with one row per turn; its number is a button that shows the turn's beginning. */
function turnsOf(details, player) {
  const { turns } = details;
  if (!turns?.length) return null;
  const show = (turn, number) =>
    player
      ? make(
          "button",
          {
            type: "button",
            "aria-label": `Show turn ${number + 1}`,
            onclick: () => player.seek(stepAt(player.scene, turn.begin)),
          },
          String(number + 1),
        )
      : String(number + 1);
  const rows = turns.map((turn, number) => [
    show(turn, number),
    turn.opponent,
    `${fixed(turn.begin, 1)} to ${fixed(turn.end, 1)} s`,
    turn.ended,
    turn.decisive ? `${turn.outcome} (decisive)` : turn.outcome,
    fixed(turn.speed, 1),
    fixed(turn.gap, 2),
    fixed(turn.ttc, 2),
  ]);
  const headings = [
    "turn", "opponent", "from, to", "ended", "outcome", "hit, m/s", "least gap, m", "least TTC, s",
  ];
  return make(
    "section",
    { "aria-label": "Turns" },
    make("h2", {}, `Turns (${turns.length})`),
    make(
      "p",
      { class: "hint" },
      "Metrics, kind and the opponent's speed are of the decisive turn; gap and TTC of each turn.",
    ),
    make("div", { class: "wide" }, make("table", {}, ...tableOf(headings, rows, [5, 6, 7]))),
  );
}

/** The attackers at a step; of opponents in turn the one whose turn it is, none between. */
function attackersAt(scene, step) {
  if (!scene.turns?.length) return [scene.opponent].filter(Boolean);
  const seconds = (step - scene.now) * scene.dt;
  const ids = scene.turns
    .filter((one) => one.begin <= seconds + 1e-6 && seconds <= one.end + 1e-6)
    .map((one) => one.opponent);
  return scene.agents.filter((agent) => ids.includes(agent.id));
}

function attackersOf(scene) {
  if (!scene.turns?.length) return scene.opponent.id;
  const together = scene.turns.every((one) => one.begin === scene.turns[0].begin);
  return together ? scene.turns.map((one) => one.opponent).join(", ") : "whose turn it is";
}

/** Where a replay begins: where the danger of a hit shows, else at the beginning of the attack. */
function beginOf(scene) {
  const turn = (scene.turns ?? []).find((one) => one.decisive);
  return scene.onset ?? (turn ? stepAt(scene, turn.begin) : scene.now);
}

/** The step at a time after the start. */
function stepAt(scene, seconds) {
  return Math.round(scene.now + seconds / scene.dt);
}

/** Of a chart: the turns as bands with their numbers. */
function turnBands(scene, x, top, bottom) {
  return (scene.turns ?? []).flatMap((turn, number) => {
    const from = x(stepAt(scene, turn.begin)),
      to = x(stepAt(scene, turn.end));
    return [
      drawn(
        "rect",
        {
          class: `turn${turn.hit ? " hit" : ""}`,
          x: from,
          y: top,
          width: Math.max(1, to - from),
          height: bottom - top,
        },
        drawn("title", {}, `turn ${number + 1}: ${turn.opponent}, ${turn.ended}`),
      ),
      drawn("text", { x: (from + to) / 2, y: top + 10, "text-anchor": "middle" }, String(number + 1)),
    ];
  });
}
