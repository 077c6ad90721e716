"""Sessions over HTTP: what they do now, and a switch for new attacks.

``GET /status`` is JSON, ``POST /start`` and ``POST /stop`` turn new attacks on and off and answer
with the status, ``GET /`` is a page with both. Only this machine can connect, and of web pages only
this one is answered: see `local_http`.
"""

import json
import threading
from collections import Counter
from collections.abc import Sequence
from http import HTTPStatus
from types import TracebackType
from typing import Any, Final, Self

from deepmf_sumo.errors import UsageError
from deepmf_sumo.live.session import Session
from deepmf_sumo.local_http import LocalHandler, LocalServer
from deepmf_sumo.scene import AgentId

DOOR: Final = "HTTP"
"""How the record of a session names a switch that came in here."""
_WITHIN_S: Final = 10.0
"""For one request."""
_MOST: Final = 32
"""Requests at a time."""
_WAITING: Final = "the first step has not come yet"
_PAGE: Final = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>deepmf-sumo: live attacks</title>
<meta name="viewport" content="width=device-width">
<style>
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem; color-scheme: light dark; }
td, th { text-align: left; padding: .2rem 1.5rem .2rem 0; }
button { font: inherit; padding: .3rem 1rem; margin: 1rem .5rem 0 0; }
</style>
<h1>Live attacks</h1>
<p id="now"></p>
<table>
<thead><tr><th>AV<th>attacked by<th>attacks<th>contacts<th>why none now</thead><tbody></tbody>
</table>
<button data-do="start">Start attacks</button><button data-do="stop">Stop attacks</button>
<script>
const NAMES = ["av", "attacking", "attacks", "contacts", "last_failure"];
function show(status) {
  document.getElementById("now").textContent =
    status.ended ?? `${status.time_s ?? 0} s, new attacks: ${status.new_attacks ?? "-"}`;
  if (!status.avs) return;
  document.querySelector("tbody").replaceChildren(...status.avs.map((one) => {
    const row = document.createElement("tr");
    for (const name of NAMES)
      row.appendChild(document.createElement("td")).textContent = one[name] ?? "-";
    return row;
  }));
}
async function ask(path, method) {
  try { show(await (await fetch(path, {method})).json()); }
  catch { show({ended: "the session has ended"}); }
}
for (const button of document.querySelectorAll("button"))
  button.onclick = () => ask("/" + button.dataset.do, "POST");
ask("/status", "GET");
setInterval(() => ask("/status", "GET"), 1000);
</script>
"""


class StatusServer:
    """Answers while it is open; until `watch` it has no sessions.

    Args:
        port: of this machine; 0 takes a free one.
        avs: the attacked vehicles.

    Attributes:
        port: as given, or the one that was free. hits: contacts so far by AV,
            counted by the caller.

    Raises UsageError for a port that is in use.
    """

    def __init__(self, port: int, avs: Sequence[AgentId]) -> None:
        self.hits: Counter[AgentId] = Counter()
        self._avs = avs
        self._before: Counter[AgentId] = Counter()
        self._sessions: Sequence[Session] = ()
        status = self

        class Handler(_Handler):
            of = status

        try:
            self._server = LocalServer(port, Handler, _MOST)
        except OSError as error:
            raise UsageError(f"live.http {port} cannot be used: {error.strerror}.") from None
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, name="status", daemon=True).start()

    def watch(self, sessions: Sequence[Session]) -> None:
        """Tell of these sessions, and switch their attacks; counts and the switch go on."""
        for old in self._sessions:
            self._before[old.av_id] += old.attacks
        for new in sessions:
            if any(old.paused for old in self._sessions):
                new.switch(on=False, door=DOOR)
        self._sessions = sessions

    def status(self) -> dict[str, Any]:
        """What ``GET /status`` answers."""
        if not self._sessions:
            waiting = [{"av": av, "last_failure": _WAITING} for av in self._avs]
            return {"time_s": None, "new_attacks": None, "avs": waiting}
        first = self._sessions[0]
        return {
            "time_s": round(first.time_s, 3),
            "new_attacks": "off" if first.paused else "on",
            "avs": [
                {
                    "av": one.av_id,
                    "attacking": one.attacking,
                    "attacks": self._before[one.av_id] + one.attacks,
                    "contacts": self.hits[one.av_id],
                    "last_failure": one.last_failure,
                }
                for one in self._sessions
            ],
        }

    def switch(self, *, on: bool) -> bool:
        """Turn new attacks on or off; False without a session."""
        for one in self._sessions:
            one.switch(on=on, door=DOOR)
        return bool(self._sessions)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Handler(LocalHandler):
    of: StatusServer
    within_s = _WITHIN_S

    def do_GET(self) -> None:  # noqa: N802 - of the base class
        if self.path == "/":
            self._answer(_PAGE.encode(), "text/html; charset=utf-8")
        elif self.path == "/status":
            self._tell()
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "there are /, /status, /start and /stop")

    def do_POST(self) -> None:  # noqa: N802 - of the base class
        if self.path not in {"/start", "/stop"}:
            self.send_error(HTTPStatus.NOT_FOUND, "POST goes to /start and /stop")
        elif self.of.switch(on=self.path == "/start"):
            self._tell()
        else:
            self.send_error(HTTPStatus.CONFLICT, _WAITING)

    def _tell(self) -> None:
        self._answer(json.dumps(self.of.status()).encode(), "application/json")

    def _answer(self, body: bytes, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)
