// A flight as it goes on: its record, its plan, and its live state over a WebSocket that is opened again when it breaks.

import { ask } from "./format.js";

const POLL_MS = 2000;
const AGAIN_MS = 1500;
const ENDED = 1000;

export class FlightFeed {
  /** Follows flight `id`; `onChange(feed)` is called after every change. `await begin()` first. */
  constructor(id, onChange) {
    this.id = id;
    this.onChange = onChange;
    this.flight = null;
    this.plan = null;
    this.live = null;
    this.heardAt = null; // when the live state last came, ms of performance.now()
    this.connected = false;
    this.problem = null;
    this.closed = false;
  }

  async begin() {
    await this.poll();
    if (!this.flight) throw this.problem;
    this.timer = setInterval(() => this.poll(), POLL_MS);
    this.connect();
  }

  get ended() {
    return Boolean(this.flight?.ended_utc);
  }

  /** Seconds since the live state came; null before it has. */
  get ageS() {
    return this.heardAt === null ? null : (performance.now() - this.heardAt) / 1000;
  }

  async poll() {
    try {
      const flight = await ask(`v1/flights/${this.id}`);
      const sha = flight.live?.replanned_sha256 ?? flight.plan_sha256;
      if (this.plan?.plan_sha256 !== sha) this.plan = await ask(`v1/flights/${this.id}/plan`);
      this.flight = flight;
      this.problem = null;
      if (!this.live || this.ended) this.take(flight.live);
    } catch (problem) {
      this.problem = problem instanceof Error ? { title: "This page has a fault", detail: problem.message } : problem;
    }
    if (!this.closed) this.onChange(this);
  }

  take(live) {
    this.live = live;
    this.heardAt = performance.now();
  }

  connect() {
    if (this.closed || this.ended) return;
    const address = new URL(`v1/flights/${this.id}/telemetry`, document.baseURI);
    address.protocol = address.protocol.replace("http", "ws");
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.addEventListener("open", () => { this.connected = true; this.onChange(this); });
    socket.addEventListener("message", (message) => {
      this.take(JSON.parse(message.data));
      this.onChange(this);
    });
    socket.addEventListener("close", (event) => {
      this.connected = false;
      if (this.closed) return;
      this.onChange(this);
      if (event.code === ENDED) this.poll();
      else setTimeout(() => this.connect(), AGAIN_MS);
    });
  }

  /** An operator command: `hold`, `launch`, `handovers/2/accept`, ... Throws the problem document where it is refused. */
  async command(what, body = {}) {
    await ask(`v1/flights/${this.id}/${what}`, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ by: "page", ...body }),
    });
    await this.poll();
  }

  close() {
    this.closed = true;
    clearInterval(this.timer);
    this.socket?.close();
  }
}
