// What happens when the page is opened.

function followAddress(content) {
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
  const { manifest } = content,
    machine = manifest.machine ?? {};
  document.title = `${content.title} – deepmf-sumo report`;
  byId("title").textContent = content.title;
  const command = (machine.command ?? [])
    .map((word, place) => (place ? word : word.split("/").pop()))
    .join(" ");
  byId("origin").textContent = [
    manifest.version ? `deepmf-sumo ${manifest.version}` : "",
    machine.started,
    command,
  ]
    .filter(Boolean)
    .join(" · ");
}

function showNotices(content) {
  const notices = [];
  if (content.interrupted)
    notices.push("This batch was interrupted: runs are missing. Go on with --resume.");
  if (content.missing)
    notices.push(
      `${counted(content.missing, "run")} cannot be replayed; the column 'note' says why.`,
    );
  const statuses = [...grouped(runs.all, (row) => row.status)].filter(
    ([status]) => status !== "ok",
  );
  if (statuses.length)
    notices.push(
      `Without a result: ${statuses.map(([status, group]) => `${group.length} ${status}`).join(", ")}.`,
    );
  byId("notices").replaceChildren(
    ...notices.map((notice) => make("p", { class: "notice" }, notice)),
  );
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
  readRows(content);
  Object.assign(groupOrders, content.orders);
  nameTheme();
  showOrigin(content);
  showNotices(content);
  showTotalsChoice();
  showAll();
  byId("theme").addEventListener("click", switchTheme);
  byId("more").addEventListener("click", () => {
    runs.most += PAGE_ROWS;
    showRuns();
  });
  byId("filters").addEventListener("submit", (event) => event.preventDefault());
  document.querySelector(".skip").addEventListener("click", (event) => {
    event.preventDefault(); // the address says which run is open
    document.querySelector("main:not([hidden])").focus();
  });
  window.addEventListener("hashchange", () => followAddress(content));
  window.addEventListener("resize", () => opened.player?.fit());
  followAddress(content);
}

start();
