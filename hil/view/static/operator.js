// What an operator may do. Every order shows its answer, and nothing here waits before an e-stop is sent.

import { write } from "./quantities.js";

const byId = (id) => document.getElementById(id);
const LABELS = {
  "reference.offset_m": "Offset",
  "reference.amplitude_m": "Amplitude",
  "reference.omega_rad_per_s": "Frequency",
  "leakage.threshold_sigma": "Residual, σ",
  "leakage.cusum_threshold": "CUSUM, σ",
  "limits.command_max_v": "Command",
  "control.switching_gain": "Switching",
};

export class Operator {
  constructor(link) {
    this.link = link;
    this.allowed = false;
    this.parameters = [];
    for (const button of document.querySelectorAll("[data-cmd]")) {
      button.onclick = () => this.command(button.dataset.cmd);
    }
    byId("acknowledge").onclick = () => this.command("acknowledge");
    byId("estop").onclick = () => this.estop();
    byId("parameters").onsubmit = (event) => {
      event.preventDefault();
      this.apply();
    };
  }

  async askRole() {
    const reply = await this.link.order({ ask: "role" });
    this.allowed = Boolean(reply.operator);
    document.body.classList.toggle("may-operate", this.allowed);
  }

  say(text, ok) {
    const place = byId("reply");
    write(place, text);
    place.dataset.ok = ok;
  }

  async command(name) {
    if (!this.allowed) return;
    this.say(`${name}: sent`, "");
    const reply = await this.link.order({ cmd: name });
    this.say(answerText(name, reply), reply.ok);
  }

  // Always goes out, whatever the page believes about state, role or connection.
  async estop() {
    if (!this.link.token) return; // view only
    const button = byId("estop");
    button.dataset.sent = "waiting";
    this.say("e-stop: sent", "");
    const reply = await this.link.estop();
    button.dataset.sent = reply.ok ? "confirmed" : "failed";
    if (reply.ok) this.say(answerText("e-stop", reply), true);
    else this.say(`E-STOP NOT CONFIRMED (${reply.error ?? reply.result}): use the hard-wired one`, false);
    setTimeout(() => delete button.dataset.sent, 3000);
  }

  // Parameters from the rig; what somebody is typing stays.
  show(parameters) {
    const form = byId("parameters");
    const known = Object.keys(LABELS);
    const place = ({ name }) => (known.includes(name) ? known.indexOf(name) : known.length);
    parameters.sort((a, b) => place(a) - place(b));
    const key = parameters.map((p) => p.name).join();
    this.parameters = parameters;
    if (key !== this.key) {
      this.key = key;
      const reference = parameters.filter((p) => p.name.startsWith("reference."));
      const others = parameters.filter((p) => !p.name.startsWith("reference."));
      const rest = document.createElement("details");
      rest.append(make("summary", "Thresholds, limits, gains"), group(others));
      form.replaceChildren(group(reference), make("p", "Acts from the next entry into ACTIVE: hold, then enable."), rest);
    }
    for (const { name, value, min, max } of parameters) {
      const input = form.elements[name];
      const touched = input.value !== input.dataset.value;
      input.dataset.value = String(value);
      input.title = `${name}: ${min} to ${max}`;
      if (!touched || Number(input.value) === value) input.value = input.dataset.value;
      input.classList.toggle("touched", input.value !== input.dataset.value);
    }
  }

  // What fits only together (offset and amplitude) may be refused in one order and taken in another: try both.
  async apply() {
    const form = byId("parameters");
    let left = this.parameters.filter(({ name }) => form.elements[name].value !== form.elements[name].dataset.value);
    if (!left.length) this.say("parameters: nothing changed", "");
    let reply = null;
    let failed = null;
    for (let before = Infinity; left.length && left.length < before; ) {
      before = left.length;
      const refused = [];
      for (const parameter of left) {
        const text = form.elements[parameter.name].value;
        reply = await this.link.order({ param: parameter.name, value: text.trim() === "" ? null : Number(text) });
        if (reply.ok) form.elements[parameter.name].dataset.value = text;
        else {
          refused.push(parameter);
          failed = answerText(`${parameter.name} = ${text}`, { ...parameter, ...reply });
        }
        if (reply.ok) this.say(answerText(`${parameter.name} = ${text}`, reply), true);
      }
      left = refused;
    }
    if (left.length) this.say(failed, false);
  }
}

function answerText(what, reply) {
  if (reply.ok) return `${what}: accepted in cycle ${reply.cycle}, ${reply.state}`;
  const where = reply.state ? ` in ${reply.state}` : "";
  if (reply.error) return `${what}: ${reply.error}`;
  if (reply.result === "out_of_range") {
    return `${what}: out of range; allowed: ${reply.min} to ${reply.max} ${reply.unit}, and inside the rig's limits together`;
  }
  return `${what}: ${reply.result.replace("_", " ")}${where}`;
}

function make(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: text });
}

function group(parameters) {
  const place = document.createElement("div");
  place.className = "fields";
  place.append(...parameters.map(field));
  return place;
}

function field({ name, unit }) {
  const label = document.createElement("label");
  const input = document.createElement("input");
  input.name = name;
  input.inputMode = "decimal";
  input.dataset.value = "";
  input.oninput = () => input.classList.toggle("touched", input.value !== input.dataset.value);
  label.append(make("span", `${LABELS[name] ?? name}${unit === "1" ? "" : `, ${unit.replace("s3", "s³")}`}`), input);
  return label;
}
