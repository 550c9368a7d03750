"""Have a person click the corners of a rectangle in a photograph, in a browser on this machine."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np

from companion.tools.pads.trace import fault_of
from estimator.contracts.geometry import F64

_MOST_BYTES = 4096
_CORNERS = ("fore left", "fore right", "aft right", "aft left")
_PAGE = """<!doctype html><meta charset="utf-8"><title>Corners of the pad</title>
<style>
body { font: 16px sans-serif; margin: 1em; background: #fff; color: #111 }
#view { position: relative; display: inline-block; cursor: crosshair } img { max-width: 100%; max-height: 80vh; display: block }
svg { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none }
polygon { fill: #0a58ca33; stroke: #0a58ca; stroke-width: 2; vector-effect: non-scaling-stroke }
button { font-size: 1em; padding: .5em 1em }
</style>
<p role="status" id="told"></p>
<p><button id="undo">Take the last one back</button> <button id="use" disabled>Use these corners</button></p>
<div id="view"><img id="photo" src="photo" alt="the photograph"><svg id="drawn" aria-hidden="true"><polygon/></svg></div>
<script>
const names = NAMES, at = [], photo = document.getElementById("photo"), drawn = document.getElementById("drawn");
const told = document.getElementById("told"), use = document.getElementById("use");
function show() {
  const next = `Click the ${names[at.length]} corner of the rectangle (${at.length} of 4).`;
  told.textContent = at.length < 4 ? next : "Four corners.";
  use.disabled = at.length < 4;
  drawn.setAttribute("viewBox", `-0.5 -0.5 ${photo.naturalWidth} ${photo.naturalHeight}`);
  drawn.firstChild.setAttribute("points", at.map(p => p.join(",")).join(" "));
}
photo.onclick = e => {
  if (at.length === 4) return;
  const box = photo.getBoundingClientRect(), px = photo.naturalWidth / box.width;
  at.push([(e.clientX - box.left) * px - 0.5, (e.clientY - box.top) * px - 0.5]);
  show();
};
document.getElementById("undo").onclick = () => { at.pop(); show(); };
use.onclick = async () => {
  const answer = await fetch("corners", { method: "POST", body: JSON.stringify(at) });
  told.textContent = answer.ok ? "Taken. Go on in the terminal." : "Refused: " + await answer.text() + ". Take some back.";
  use.disabled = true;
};
photo.onload = show; if (photo.complete) show();
</script>"""


def corners_of(body: bytes) -> F64:
    """Return the places, (4, 2) px, that a browser sent.

    Raises:
        ValueError: they are not four pairs of finite numbers, or no rectangle's.
    """
    try:
        at = np.array(json.loads(body), float)
    except (TypeError, ValueError, RecursionError) as why:
        raise ValueError("four pairs of numbers are wanted") from why
    if at.shape != (4, 2) or not np.isfinite(at).all():
        raise ValueError("four pairs of numbers are wanted")
    fault = fault_of(at)
    if fault is not None:
        raise ValueError(f"the corners {fault}")
    return at


def clicked(photo: bytes, tell: Callable[[str], None]) -> F64:
    """Serve a photograph to a browser on this machine until a person has clicked four corners; return them, (4, 2) px.

    Args:
        photo: as the browser reads it, JPEG or PNG.
        tell: is given the address of the page, which nobody can guess.
    """
    secret, found = secrets.token_urlsafe(16), list[F64]()
    answers = {
        f"/{secret}/": (_PAGE.replace("NAMES", json.dumps(_CORNERS)).encode(), "text/html"),
        f"/{secret}/photo": (photo, ""),
    }

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body, kind = answers.get(self.path, (b"", ""))
            self._answer(HTTPStatus.OK if body else HTTPStatus.NOT_FOUND, body, kind)

        def do_POST(self) -> None:
            length = self.headers.get("Content-Length", "")
            if self.path != f"/{secret}/corners" or not length.isdecimal() or int(length) > _MOST_BYTES:
                return self._answer(HTTPStatus.NOT_FOUND)
            try:
                found.append(corners_of(self.rfile.read(int(length))))
            except ValueError as why:
                return self._answer(HTTPStatus.BAD_REQUEST, str(why).encode())
            return self._answer(HTTPStatus.OK)

        def _answer(self, status: HTTPStatus, body: bytes = b"", kind: str = "") -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            if kind:
                self.send_header("Content-Type", kind)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        tell(f"http://127.0.0.1:{server.server_address[1]}/{secret}/")
        while not found:
            server.handle_request()
    return found[0]
