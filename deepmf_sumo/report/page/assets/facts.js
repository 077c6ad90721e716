// What is known of an opened run beside the replay.

function definitions(facts) {
  return make(
    "dl",
    {},
    ...Object.entries(facts).flatMap(([name, value]) => [
      make("dt", {}, name),
      make("dd", {}, String(value)),
    ]),
  );
}

/** A command with a button that copies it. */
function commandLine(text) {
  const button = make("button", { type: "button", onclick: () => copied(text, button) }, "Copy");
  return make("div", { class: "command" }, make("pre", {}, text), button);
}

async function copied(text, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // pages from a file may have no clipboard: the older command needs a selection
    const area = make("textarea", { readonly: true });
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
    button.focus();
  }
  button.textContent = "Copied";
  setTimeout(() => {
    button.textContent = "Copy";
  }, 1500);
}

function quoted(text) {
  return /^[\w./:=@+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

/** The commands that repeat the run and show it in SUMO, from within the result folder. */
function commandsOf(row, details) {
  const folder = `runs/${row.run}`;
  const elements = [
    make("h2", {}, "Run it again"),
    make("p", { class: "hint" }, "From within the result folder:"),
    commandLine(
      `deepmf-sumo run ${quoted(`${folder}/spec.yaml`)} --out ${quoted(`../${row.run}`)}`,
    ),
  ];
  if (details.gui)
    elements.push(
      make("p", { class: "hint" }, "The replay in SUMO:"),
      commandLine(`sumo-gui -c ${quoted(`${folder}/sumo/replay.sumocfg`)}`),
    );
  return make("section", {}, ...elements);
}

/** Where it would have been, with which the attack is compared. */
const UNATTACKED = {
  log: "as recorded",
  episode: "as in the same episode without it",
  lane: "keeps lane and speed (the episode cannot be repeated)",
};

function factsOf(row, details, content) {
  const { manifest } = content;
  const packages = Object.entries(manifest.packages ?? {})
    .map(([name, version]) => `${name} ${version ?? "not installed"}`)
    .join(", ");
  const facts = {
    scene: row.scene,
    "edge at the start": row.edge,
    "AV's next turn": row.turn,
    method: row.method,
    planner: row.planner,
    seed: details.seed ?? row.seed,
    adversary: [details.adversary, details.version].filter(Boolean).join(" "),
    profile: details.profile,
    constraints: (details.constraints ?? []).join(", "),
    ended: details.ended,
    "supported by": (details.supporters ?? []).join("; "),
    "people who were made, not in the demand": (details.made ?? []).join("; "),
    "opponent without the attack": UNATTACKED[details.counterfactual],
    plans: details.plans,
    "deepmf-sumo": manifest.version,
    packages,
    weights: weightsText(details.weights, content),
  };
  return make(
    "section",
    {},
    make("h2", {}, "Facts"),
    definitions(
      Object.fromEntries(
        Object.entries(facts).filter(
          ([, value]) => value !== undefined && value !== null && value !== "",
        ),
      ),
    ),
  );
}

function weightsText(name, content) {
  if (!name) return null;
  const cards = content.weights[name];
  if (!Array.isArray(cards)) return `${name} (licence not known: ${cards})`;
  const byLicence = [...grouped(cards, ([, licence]) => licence)];
  return `${name}; licence, from the cards found when this page was written: ${byLicence.map(([licence, group]) => `${licence} (${group.map(([network]) => network).join(", ")})`).join("; ")}`;
}

function metricsOf(details) {
  const rows = Object.entries(details.metrics).map(([name, [value, unit, reason]]) => [
    name,
    value === null ? "–" : String(Number(value.toPrecision(5))),
    unit === "1" ? "" : unit,
    reason,
  ]);
  return folded(
    `Metrics (${rows.length})`,
    make(
      "div",
      { class: "wide" },
      make("table", {}, ...tableOf(["metric", "value", "unit", "why not measured"], rows, [1])),
    ),
  );
}

function eventsOf(details) {
  const now = details.replay?.now ?? 0,
    dt = details.replay?.dt ?? 0.1;
  const rows = details.events.map(([step, agent, kind, detail]) => [
    `${((step - now) * dt).toFixed(1)} s`,
    agent,
    kind,
    detail,
  ]);
  return rows.length
    ? folded(
        `Events (${rows.length})`,
        make("table", {}, ...tableOf(["at", "agent", "event", "detail"], rows)),
      )
    : null;
}

function folded(title, ...children) {
  return make("details", {}, make("summary", {}, title), ...children);
}

function textsOf(details) {
  const texts = {
    Settings: details.settings ? JSON.stringify(details.settings, null, 2) : "",
    Spec: details.spec,
    "Repairs of the recording": details.repairs.join("\n"),
    Tries: details.tries,
    "End of the log": details.log,
  };
  return Object.entries(texts)
    .filter(([, text]) => text)
    .map(([title, text]) => folded(title, make("pre", {}, text)));
}
