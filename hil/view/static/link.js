// The websocket: comes back by itself; orders with their answers; the e-stop on two ways at once.

const RETRY_MS = 1000;
const PATIENCE_MS = 4000;

export class Link {
  // take: {text(content), block(buffer), change(isOpen)}
  constructor(take) {
    this.take = take;
    this.open = false;
    this.number = 0;
    this.waiting = new Map();
    this.token = readToken();
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.open = true;
      this.take.change(true);
    };
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        this.take.block(data);
        return;
      }
      const content = JSON.parse(data);
      if ("reply" in content) this.settle(content);
      else this.take.text(content);
    };
    socket.onclose = () => {
      this.open = false;
      for (const number of [...this.waiting.keys()]) {
        this.settle({ reply: number, ok: false, result: "no_connection", error: "the page lost its server" });
      }
      this.take.change(false);
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  settle(content) {
    const resolve = this.waiting.get(content.reply);
    this.waiting.delete(content.reply);
    if (resolve) resolve(content);
  }

  // The answer to {cmd}, {param, value} or {ask}; always one, never an exception.
  order(content) {
    this.number += 1;
    const id = this.number;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      if (this.open) this.socket.send(JSON.stringify({ id, token: this.token, ...content }));
      else this.settle({ reply: id, ok: false, result: "no_connection", error: "the page has no server" });
      setTimeout(() => {
        this.settle({ reply: id, ok: false, result: "no_reply", error: "no answer within 4 s" });
      }, PATIENCE_MS);
    });
  }

  // The first way that says yes counts; the answer of the last one if none does.
  async estop() {
    const direct = fetch("/estop", { method: "POST", headers: { "X-Token": this.token } })
      .then((answer) => answer.json())
      .catch((error) => ({ ok: false, result: "no_connection", error: String(error) }));
    const ways = [direct, this.order({ cmd: "estop" })];
    const sure = ways.map((way) => way.then((reply) => (reply.ok ? reply : Promise.reject(reply))));
    return Promise.any(sure).catch((failed) => failed.errors.at(-1));
  }
}

// From the address that the operator was given; taken out of it, so that nobody reads it over a shoulder.
function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("servohil.token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("servohil.token") ?? "";
}
