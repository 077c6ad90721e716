// Which layers are drawn, and the key.

const LAYERS = {
  map: "road",
  lights: "traffic lights",
  driven: "paths driven",
  heat: "where the opponent may be in 8 s",
  candidates: "candidates",
  reactions: "predicted reactions of the AV",
  scores: "opponent scores",
  unseen: "hidden from the AV",
};

/** What the planner knew of hidden road users, by the spec's key `av_sees`. */
const SHOWN = {
  in_sight: "The planner was not shown hidden road users.",
  all: "The planner was shown everybody, hidden or not (av_sees: all).",
};

function layers(scene, draw) {
  const heat = scene.plans.some((plan) => plan.heat);
  const unseen = scene.agents.some((agent) => agent.unseen);
  const missing = { lights: !scene.lights.length, heat: !heat, unseen: !unseen };
  const named = Object.entries(LAYERS).filter(([name]) => !missing[name]);
  const boxes = named.map(([name, label]) =>
    layer(label, playing.shown[name], (on) => {
      playing.shown[name] = on;
      draw();
    }),
  );
  boxes.push(
    layer("keep the AV in the middle", playing.follow, (on) => {
      playing.follow = on;
      draw();
    }),
  );
  const key = (colour, label, look = "") =>
    make(
      "p",
      {},
      make("span", {
        class: `key ${look}`,
        style: look ? `border-top-color:var(--${colour})` : `background:var(--${colour})`,
      }),
      label,
    );
  const ramp = [0, 0.25, 0.5, 0.75, 1].map(scoreColour).join(",");
  return make(
    "section",
    { "aria-label": "Layers and key" },
    ...boxes,
    key("av", `AV (${scene.av.id})`),
    scene.opponent ? key("opponent", `opponent (${attackersOf(scene)}), with a star`) : null,
    key("opponent", "its plan", "stroke dashed"),
    ...scene.supporters.map((one) =>
      key("supporter", `supporter (${one.id}): takes ways out from the AV`),
    ),
    heat ? key("heat", "where it may be in 8 s; stronger colour: likelier") : null,
    key("candidate", "candidates; stronger colour: higher value", "stroke"),
    key("reaction", "reactions; solid line: collides", "stroke"),
    make(
      "p",
      {},
      make("span", { class: "key", style: `background:linear-gradient(90deg,${ramp})` }),
      "others by score, 0 to 1; grey: none",
    ),
    ...(unseen ? [key("other-edge", "hidden from the AV", "hollow"), hint(SHOWN[scene.sees])] : []),
    ...mapLayers
      .filter(([, of, , , words]) => words && scene.shapes.some((shape) => shape.kind === of))
      .map(([name, , , , words]) => key(`map-${name}`, words)),
    make("p", {}, "× contact"),
    scene.hidden
      ? hint(
          `Not drawn: ${counted(scene.hidden, "vehicle or person that never comes", "vehicles and persons that never come")} within 100 m.`,
        )
      : null,
  );
}

function hint(text) {
  return text ? make("p", { class: "hint" }, text) : null;
}

function layer(label, checked, onchange) {
  return make(
    "label",
    {},
    make("input", {
      type: "checkbox",
      checked,
      onchange: (event) => onchange(event.target.checked),
    }),
    ` ${label}`,
  );
}
