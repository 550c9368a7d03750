// The connection: login, messages to those who want them, and trying again after a loss.
import { $, chip } from "./elements.js";
import { inUnits } from "./units.js";

const WRONG_TOKEN = 4401;
const GOING = 1001;
const SILENT_MS = 2500; // a state comes ten times a second
const QUIET_S = 1; // from here on what the page shows is old, and an order would come late
const AGAIN_MS = 1000;
// This page over all its connections, lest its own orders be those of another one after a loss.
const PAGE = crypto.getRandomValues(new Uint32Array(4)).join("-");

export class Link {
  #handlers = new Map();
  #socket = null;
  #token = "";
  #receivedAt = 0;
  #refusal = "";
  #decoder = new TextDecoder();
  onLost = () => {};
  onQuiet = () => {};
  onRefused = () => {};

  constructor() {
    setInterval(() => this.#watch(), 250);
    addEventListener("online", () => this.#watch());
  }

  on(kind, handler) {
    this.#handlers.set(kind, [...(this.#handlers.get(kind) ?? []), handler]);
  }

  get quiet_s() {
    return (performance.now() - this.#receivedAt) / 1000;
  }

  get live() {
    return this.#socket !== null && this.#socket.readyState === WebSocket.OPEN;
  }

  open(token) {
    this.#token = token;
    this.#drop();
    const address = new URL("operator", location.href); // beside the page, which a proxy may serve under a path
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#receivedAt = performance.now();
    this.#refusal = "";
    socket.onopen = () => socket.send(JSON.stringify({ kind: "login", token, page: PAGE }));
    socket.onmessage = (message) => this.#take(message.data);
    socket.onclose = (event) => {
      if (this.#socket !== socket) return;
      this.#socket = null;
      if (event.code === WRONG_TOKEN) this.onRefused(this.#refusal || event.reason || "the token is wrong");
      else this.#again(this.#refusal || event.reason || "The connection is lost", event.code === GOING && this.#refusal !== "");
    };
  }

  // Returns whether the message left; what a lost connection does not take is not kept here.
  send(message, inTime = false) {
    if (!this.live || (inTime && this.quiet_s > QUIET_S)) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  // Sends the request of a tool; its note then says what is under way, or that the request did not leave.
  ask(note, message, words = "") {
    const sent = this.send(message);
    chip($(note), sent ? "" : "fault", sent ? words : "not sent, the connection is lost");
  }

  #take(data) {
    this.#receivedAt = performance.now();
    if (data instanceof ArrayBuffer) {
      const length = new DataView(data).getUint32(0, true);
      const header = JSON.parse(this.#decoder.decode(new Uint8Array(data, 4, length)));
      for (const handler of this.#handlers.get("picture")) handler(header, new Uint8Array(data, 4 + length));
      return;
    }
    const given = JSON.parse(data);
    const message = inUnits(given);
    if (message.kind === "refused") this.#refusal = message.text;
    else for (const handler of this.#handlers.get(message.kind) ?? []) handler(message, given);
  }

  #watch() {
    if (this.#socket === null) return;
    if (this.live) this.onQuiet(this.quiet_s > QUIET_S ? this.quiet_s : null);
    if (1000 * this.quiet_s < SILENT_MS) return;
    this.#drop();
    this.#again("The service is silent");
  }

  #again(why, ends = false) {
    this.onLost(why.charAt(0).toUpperCase() + why.slice(1), ends);
    setTimeout(() => {
      if (this.#socket === null) this.open(this.#token);
    }, AGAIN_MS);
  }

  #drop() {
    const socket = this.#socket;
    this.#socket = null;
    if (socket !== null) Object.assign(socket, { onmessage: null, onclose: null }).close();
  }
}
