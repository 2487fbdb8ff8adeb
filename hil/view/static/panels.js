// Everything beside the plots: state, alarms, leaks, numbers, timing, events.

import { clock, figure, micros, write } from "./quantities.js";

const L_PER_MIN = 6e4; // of a m3/s
const BAR = 1e5;
const byId = (id) => document.getElementById(id);
const EVENTS = 60;

const LEAKS = { internal: "Internal A→B", external_a: "External A", external_b: "External B" };
const NOW = [
  ["tracking error", "mm", 3, (n) => (n.position_m - n.ref_position_m) * 1e3, (n) => n.position_m !== null],
  ["position, estimated", "mm", 2, (n) => n.est_position_m * 1e3],
  ["velocity, estimated", "mm/s", 1, (n) => n.est_velocity_mps * 1e3],
  ["pressure A", "bar", 2, (n) => n.est_pressure_a_pa / BAR, null, (n) => n.std_pressure_a_pa / BAR],
  ["pressure B", "bar", 2, (n) => n.est_pressure_b_pa / BAR, null, (n) => n.std_pressure_b_pa / BAR],
  ["supply", "bar", 1, (n) => n.supply_pa / BAR, (n) => n.supply_pa !== null],
  ["tank", "bar", 1, (n) => n.tank_pa / BAR, (n) => n.tank_pa !== null],
  ["valve command", "V", 3, (n) => n.command_v],
  ["innovation (NIS)", "", 2, (n) => n.nis],
];

export class Panels {
  constructor() {
    this.faults = "";
    this.level = "none";
    this.seen = 0;
    const body = byId("now").tBodies[0];
    this.rows = NOW.map(([name, unit]) => {
      const row = body.insertRow();
      row.appendChild(document.createElement("th")).textContent = name;
      const value = row.insertCell();
      row.insertCell().textContent = unit;
      return value;
    });
  }

  state(now) {
    const badge = byId("state");
    write(badge, now.state.replace("_", " "));
    badge.dataset.state = now.state;
    write(byId("time"), clock(now.t_ns / 1e9));
    write(byId("overruns"), String(now.overruns));
    this.period = now.t_ns / 1e9 / now.cycle;
    NOW.forEach(([, , digits, value, known, std], i) => {
      const text = known && !known(now) ? "–" : figure(value(now), digits);
      write(this.rows[i], std ? `${text} ± ${figure(2 * std(now), digits)}` : text);
    });
  }

  diagnosis(content, now) {
    const judging = content.mode === "judging";
    write(byId("mode"), judging ? "something changed, judging" : content.mode);
    byId("leak").dataset.level = content.level;
    byId("leak").dataset.mode = content.mode;
    const leaking = content.level !== "none";
    const flow = content.leaks[content.leak]?.flow_m3ps;
    const leak = `${LEAKS[content.leak] ?? "Leak"}: ${figure(flow === undefined ? null : flow * L_PER_MIN, 2)} l/min`;
    write(byId("leak-text"), leaking ? leak : judging ? "Change flagged" : "No leak");
    for (const row of document.querySelectorAll("[data-leak]")) {
      const { flow_m3ps: flow, coefficient, std } = content.leaks[row.dataset.leak];
      row.classList.toggle("found", leaking && content.leak === row.dataset.leak);
      write(row.cells[1], figure(flow === null ? null : flow * L_PER_MIN, 3));
      const size = figure(coefficient === null ? null : coefficient * 1e12, 2);
      write(row.cells[2], `${size} ± ${figure(std === null ? null : 2 * std * 1e12, 2)}`);
    }
    const words = content.verdict
      ? `Last change: ${content.verdict.change ?? "no single cause"}, cycle ${content.verdict.since_cycle}`
      : "Nothing has changed so far";
    write(byId("change"), words);
    this.alarms(content, now);
  }

  alarms(content, now) {
    const active = [];
    if (content.level !== "none") active.push([content.level, `Leak ${content.level}`, content.text]);
    if (now.fault) active.push(["fault", "Fault latched", this.faults]);
    const key = JSON.stringify(active.map(([level, title, text]) => [level, title, level === "fault" ? text : ""]));
    const list = byId("alarm-list");
    if (key !== this.alarmKey) {
      this.alarmKey = key;
      list.replaceChildren(
        ...active.map(([level, title]) => {
          const item = document.createElement("li");
          item.dataset.level = level;
          item.append(Object.assign(document.createElement("strong"), { textContent: title }), document.createElement("span"));
          return item;
        }),
      );
      if (!active.length) list.append(Object.assign(document.createElement("li"), { className: "none", textContent: "none active" }));
      byId("alarms").classList.toggle("alarmed", active.length > 0);
    }
    active.forEach(([, , text], i) => write(list.children[i].lastElementChild, text));
    byId("acknowledge").disabled = content.level === "none";
  }

  health(content) {
    for (const row of document.querySelectorAll("[data-spread]")) {
      const figures = content[row.dataset.spread] ?? {};
      ["p50", "p99", "p999", "max"].forEach((name, i) => write(row.cells[i + 1], micros(figures[name])));
    }
    this.rate = content.rate_hz;
  }

  counts(now, lost) {
    const pairs = [
      ["rate", this.rate ? `${this.rate.toFixed(1)} Hz` : "–"],
      ["cycle", String(now.cycle)],
      ["overruns", String(now.overruns)],
      ["frames rejected", String(now.rx_rejected)],
      ["not sent", String(now.tx_failed)],
      ["batches lost", String(lost)],
    ];
    const list = byId("counts");
    if (!list.children.length) {
      list.append(
        ...pairs.map(([name]) => {
          const pair = document.createElement("div");
          pair.append(Object.assign(document.createElement("dt"), { textContent: name }), document.createElement("dd"));
          return pair;
        }),
      );
    }
    pairs.forEach(([, value], i) => write(list.children[i].lastElementChild, value));
  }

  lateness(counts, { first_us, per_octave }) {
    const chart = byId("histogram");
    if (chart.children.length !== counts.length) {
      chart.replaceChildren(
        ...counts.map((_, i) => {
          const from = first_us * 2 ** (i / per_octave);
          const bar = document.createElement("i");
          bar.dataset.from = from;
          const decade = 10 ** Math.round(Math.log10(from));
          if (Math.abs(Math.log2(from / decade)) <= 0.25) {
            bar.dataset.label = decade >= 1e6 ? "1 s" : decade >= 1e3 ? `${decade / 1e3} ms` : `${decade} µs`;
          }
          return bar;
        }),
      );
    }
    const most = Math.log10(1 + Math.max(1, ...counts));
    counts.forEach((count, i) => {
      const bar = chart.children[i];
      bar.style.setProperty("--height", `${((100 * Math.log10(1 + count)) / most).toFixed(1)}%`);
      bar.title = `from ${micros(Number(bar.dataset.from))} µs: ${count} cycles`;
    });
  }

  events(events) {
    const list = byId("events");
    for (const event of events) {
      if (event.code === "fault") this.faults = (event.names ?? []).join(", ");
      const item = document.createElement("li");
      item.dataset.severity = event.severity;
      const time = document.createElement("time");
      const seconds = event.t_ns === undefined ? event.cycle * this.period : event.t_ns / 1e9;
      time.textContent = Number.isFinite(seconds) ? `${clock(seconds)} s` : "";
      const text = document.createElement("span");
      text.textContent = event.text ?? event.code;
      item.append(time, text);
      list.prepend(item);
    }
    while (list.children.length > EVENTS) list.lastElementChild.remove();
  }

  clearEvents() {
    byId("events").replaceChildren();
  }
}
