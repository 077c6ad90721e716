// What happens when the page is opened.

function showChoices() {
  const field = (label, name, names) =>
    make(
      "label",
      {},
      label,
      choice(
        Object.keys(names),
        risk[name],
        (value) => {
          risk[name] = value;
          risk.picked = null;
          risk.show();
        },
        (value) => names[value],
      ),
    );
  const events = Object.fromEntries(Object.keys(risk.definitions).map((name) => [name, name]));
  byId("choices").replaceChildren(
    field("places", "kind", KIND_NAMES),
    field("an attack counts where it", "counted", { decided: "was decided", began: "began" }),
    field("risk of", "event", events),
  );
}

function showNotices(content) {
  const left = Object.entries(content.leftOut).map(([reason, count]) => `${count} ${reason}`);
  const notices = [];
  if (left.length) notices.push(`Runs that are not counted: ${left.join(", ")}.`);
  const off = content.off[risk.counted];
  if (off) notices.push(`${off} attacks were at no lane and in no junction; they are in no place.`);
  byId("notices").replaceChildren(...notices.map((text) => make("p", { class: "notice" }, text)));
}

function start() {
  const content = JSON.parse(byId("content").textContent);
  readPlaces(content);
  risk.definitions = content.definitions;
  document.title = `${content.title} – deepmf-sumo risk map`;
  byId("title").textContent = content.title;
  byId("origin").textContent = `network ${content.network} · ${content.attacks.length} attacks`;
  const pick = (number) => {
    risk.picked = number;
    risk.show();
  };
  risk.show = () => {
    const places = shownPlaces();
    showChoices();
    showNotices(content);
    drawMap(content, places, pick);
    showTable(places, pick);
    showAttacks(content);
    const kinds = risk.kind === "site" ? ["movement", "edge"] : [risk.kind];
    const all = kinds.reduce((sum, kind) => sum + content.places[kind], 0);
    const nothing = risk.counted === "decided" ? "nothing was decided" : "nothing began";
    byId("shown").textContent =
      `${places.length} of ${all}` + (places.length < all ? `; at the others ${nothing}` : "");
    byId("meaning").textContent =
      `${risk.event}: ${content.definitions[risk.event]}. Risk: chance of it in an attack at the place, drawn ` +
      `towards the network's rate as far as data are thin, with the ${content.confidence} % interval; ` +
      `ranks go by its lower end.`;
  };
  fitMap(content);
  steerMap(content);
  byId("more").addEventListener("click", () => {
    risk.most += 100;
    risk.show();
  });
  byId("choices").addEventListener("submit", (event) => event.preventDefault());
  risk.show();
}

start();
