// What happens when the page is opened.

const VIEWS = { overview: "#", "map-view": "#risk" };

/** Show one of the parts of the page; an opened run is closed by others. */
function showView(name) {
  for (const view of [...Object.keys(VIEWS), "details"]) byId(view).hidden = view !== name;
  if (name !== "details") byId("details").replaceChildren();
  for (const link of byId("views").querySelectorAll("a")) {
    const here = link.getAttribute("href") === VIEWS[name];
    if (here) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

function followAddress(content) {
  if (content.maps.length && (location.hash === "#risk" || !runs.all.length)) {
    closeRun();
    showView("map-view");
    return openMap(opened.map ?? 0, content);
  }
  const row = runs.all.find((one) => runAddress(one) === location.hash);
  if (!row) return showOverview();
  return openRun(row.number, content).catch((error) =>
    byId("details").replaceChildren(
      navigation(row),
      make("p", { class: "notice" }, `This run cannot be shown: ${error.message}`),
    ),
  );
}

function showOrigin(content) {
  const { manifest = {} } = content,
    machine = manifest.machine ?? {},
    whole = runs.all.length > 0;
  document.title = `${content.title} – deepmf-sumo ${whole ? "report" : "risk map"}`;
  byId("title").textContent = whole ? content.title : `Risk map: ${content.title}`;
  const command = (machine.command ?? [])
    .map((word, place) => (place ? word : word.split("/").pop().replace("main.py", "deepmf-sumo")))
    .join(" ");
  byId("origin").textContent = [
    manifest.version ? `deepmf-sumo ${manifest.version}` : "",
    machine.started,
    command,
    content.profile,
  ]
    .filter(Boolean)
    .join(" · ");
}

function showNotices(content) {
  const notices = [];
  if (content.interrupted)
    notices.push("This batch was interrupted: runs are missing. Go on with --resume.");
  for (const sentence of content.switchedOff ?? [])
    notices.push(`This session did not attack all the time: ${sentence}.`);
  if (content.missing)
    notices.push(
      `${counted(content.missing, "run")} cannot be replayed; the column 'note' says why.`,
    );
  if (content.withoutMap) notices.push(`There is no risk map: ${content.withoutMap}`);
  const statuses = [...grouped(runs.all, (row) => row.status)].filter(
    ([status]) => status !== "ok",
  );
  if (statuses.length)
    notices.push(
      `Without a result: ${statuses.map(([status, group]) => `${group.length} ${status}`).join(", ")}.`,
    );
  showTexts("notices", notices);
}

function isDark() {
  const { theme } = document.documentElement.dataset;
  return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function nameTheme() {
  byId("theme").textContent = isDark() ? "Light colours" : "Dark colours";
}

function switchTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
  nameTheme();
  opened.player?.draw();
}

function start() {
  const content = JSON.parse(stored("content"));
  readRuns(content);
  scoreStops.push(...content.scores);
  mapLayers.push(...content.layers);
  nameTheme();
  showOrigin(content);
  byId("views").hidden = !(content.maps.length && runs.all.length);
  if (runs.all.length || !content.maps.length) {
    Object.assign(groupOrders, content.orders);
    showNotices(content);
    failures.groups = content.failures ?? [];
    failures.causes = content.causes ?? "";
    showFailures();
    showTotalsChoice();
    showAll();
  }
  byId("theme").addEventListener("click", switchTheme);
  byId("optional").addEventListener("change", (event) => {
    risk.optional = event.target.checked;
    showRisk();
  });
  for (const form of ["filters", "choices"])
    byId(form).addEventListener("submit", (event) => event.preventDefault());
  document.querySelector(".skip").addEventListener("click", (event) => {
    event.preventDefault(); // the address says which run is open
    document.querySelector("main:not([hidden])").focus();
  });
  window.addEventListener("hashchange", () => followAddress(content));
  window.addEventListener("resize", () => {
    opened.player?.fit();
    if (!byId("map-view").hidden && mapCamera) applyView();
  });
  return followAddress(content);
}

/** Done once the page shows what its address asks for. */
const started = start();
