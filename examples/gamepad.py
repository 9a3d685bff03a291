"""Move an arm of a console with a gamepad, which the browser reads on a page that contains the console's page.

trocar run peg-transfer --method person --watch --devices 7000
python examples/gamepad.py --devices 7000 --arm psm1

Open the printed address, and press a button of the gamepad. Hold the right shoulder button to move: the left stick
moves along the table, the right one up and down and about the vertical. The right trigger closes the jaws; they open
when it is released. A: take the arm over; B: stop; X: go on; Back: emergency stop; Start: done. If the camera looks
along -y of the world, as in the debridement, give --facing -90.
"""

import argparse
import json
import socket
from http import HTTPStatus

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Response
from websockets.sync.server import serve

PAGE = """<!doctype html>
<meta charset="utf-8"><title>Trocar: gamepad</title>
<style>
  body { margin: 0; display: flex; flex-direction: column; height: 100vh }
  p { margin: 0; padding: .5em 1em; font: 15px system-ui; background: #16181d; color: #e8e8e8 }
  iframe { flex: 1; border: 0 }
</style>
<p id="words">Press a button of the gamepad.</p>
<iframe title="Console"></iframe>
<script>
const ARM = %(arm)s, FACING = %(facing)s * Math.PI / 180, SPEED = 0.03, TURNS = 0.8, OPEN = 0.4, STILL = 0.12, RATE = 20
const HOLD = 5, CLOSE = 7, WISHES = {0: "take", 1: "stop", 2: "go_on", 8: "emergency", 9: "done"}
const open = () => fetch(%(console)s, {mode: "no-cors"}).then(  // once the console's page is there
  () => { document.querySelector("iframe").src = %(console)s }, () => setTimeout(open, 1000))
open()
const words = document.querySelector("#words"), socket = new WebSocket(`ws://${location.host}/`)
let position = [0, 0, 0], yaw = 0, before = null, pressed = {}, closed = false, waits = true
const stick = value => Math.abs(value) < STILL ? 0 : value ** 3  // fine near the middle, which no stick holds exactly
const say = line => { waits = true; socket.send(JSON.stringify({arm: ARM, ...line})) }
socket.onopen = () => { waits = false }
socket.onmessage = event => {
  const answer = JSON.parse(event.data)
  waits = false
  words.textContent = answer.error ?? answer.words ?? ""
}
socket.onclose = () => { words.textContent = "The console has ended." }
setInterval(() => {  // every 20 ms: an arm is let go if nothing is heard for .3 s
  const pad = [...navigator.getGamepads()].find(pad => pad?.mapping === "standard")
  const now = performance.now() / 1000, after = Math.min(now - (before ?? now), 0.1)
  before = now
  if (!pad || waits) return
  for (const [button, wish] of Object.entries(WISHES)) {
    const down = pad.buttons[button].pressed
    if (down && !pressed[button]) { pressed[button] = down; return say({wish}) }
    pressed[button] = down
  }
  const close = pad.buttons[CLOSE].value > 0.5
  if (close !== closed) { closed = close; return say({jaw: closed ? 0 : OPEN}) }
  const [right, down, turn, fall] = pad.axes.map(stick), held = pad.buttons[HOLD].pressed
  if (held) {
    const x = right * SPEED * after, y = -down * SPEED * after, c = Math.sin(FACING), s = -Math.cos(FACING)
    position = [position[0] + c * x - s * y, position[1] + s * x + c * y, position[2] - fall * SPEED * after]
    yaw -= turn * TURNS * after
  }
  const quaternion = [0, 0, Math.sin(yaw / 2), Math.cos(yaw / 2)]
  say(held ? {held, position, quaternion} : {held})
}, RATE)
</script>
"""


def page(console, arm, facing_deg):
    """Return a handler that serves the page, and lets the web socket of the page's script pass."""
    body = (PAGE % {"console": json.dumps(console), "arm": json.dumps(arm), "facing": facing_deg}).encode()
    headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(body))})

    def answer(connection, request):
        return None if "Upgrade" in request.headers else Response(HTTPStatus.OK, "OK", headers, body)

    return answer


def relay(devices):
    """Return a handler that passes the page's lines to the console, and the console's answers to the page."""

    def run(browser):
        with socket.create_connection(("127.0.0.1", devices)) as console, console.makefile("rwb") as stream:
            try:
                for line in browser:
                    stream.write(line.encode() + b"\n")
                    stream.flush()
                    answer = stream.readline()
                    if not answer:
                        break
                    browser.send(answer.decode())
            except (ConnectionClosed, OSError):
                pass  # the page or the console is gone, and the arm is let go

    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--devices", type=int, default=7000, help="Port of the console's devices.")
    parser.add_argument("--console", default="http://127.0.0.1:8080", help="Address of the console's page.")
    parser.add_argument("--arm", default="psm1")
    parser.add_argument("--facing", type=float, default=90, help="Degrees from the world's x axis to where one looks.")
    parser.add_argument("--port", type=int, default=8090, help="Port of this page.")
    given = parser.parse_args()
    answer = page(given.console, given.arm, given.facing)
    host, here = "127.0.0.1", f"http://127.0.0.1:{given.port}"
    # no other page of the browser may move the arm
    try:
        server = serve(relay(given.devices), host, given.port, origins=[here, None], process_request=answer)
    except OSError:
        parser.error(f"--port {given.port} is taken, or not yours to have; give another")
    with server:
        print(here, flush=True)
        server.serve_forever()
