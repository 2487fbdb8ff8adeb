// Wiring: what comes in, what is drawn when, keys, theme, and the one judgement that matters most: is this now?

import { History } from "./history.js";
import { Link } from "./link.js";
import { Operator } from "./operator.js";
import { Panels } from "./panels.js";
import { FACTORS, figure, write } from "./quantities.js";
import { Strips } from "./strips.js";

const WINDOWS = [[5, "5 s"], [10, "10 s"], [30, "30 s"], [60, "1 min"], [300, "5 min"], [600, "10 min"]];
const DRAW_MS = 33;
const READ_MS = 100;
const THEMES = ["", "light", "dark"];
const byId = (id) => document.getElementById(id);

const strips = new Strips(byId("strips"));
const panels = new Panels();
const page = {
  history: null,
  seconds: 10,
  pausedAt: null,
  age: null, // {ms, at}: age of the newest cycle when the last text came
  best: Infinity, // smallest difference between the server's clock and ours: what is above it waited on the way
  staleMs: 500,
  bins: null,
  endpoint: "",
  problem: null,
  changed: true,
};

const link = new Link({
  text: takeText,
  block: (buffer) => {
    if (page.history) page.history.take(buffer);
    page.changed = true;
  },
  change: (isOpen) => {
    if (isOpen) operator.askRole();
  },
});
const operator = new Operator(link);

function takeText(content) {
  if (content.hello) {
    page.endpoint = content.hello.endpoint;
    page.best = Infinity;
    write(byId("rig"), content.hello.rig);
    write(byId("endpoint"), page.endpoint);
    document.title = `${content.hello.rig} – servohil`;
  }
  if (content.columns) {
    page.history = new History(content.columns, FACTORS);
    page.bins = content.lateness_bins;
    page.staleMs = content.stale_ms;
    panels.clearEvents();
  }
  if (content.now) {
    panels.state(content.now);
    panels.counts(content.now, content.lost);
    panels.diagnosis(content.diagnosis, content.now);
  }
  if (content.events) panels.events(content.events);
  if (content.parameters) operator.show(content.parameters);
  if (content.health) panels.health(content.health);
  if (content.lateness && page.bins) panels.lateness(content.lateness, page.bins);
  if ("age_ms" in content) {
    const behind = Date.now() - content.sent_ms;
    page.best = Math.min(page.best, behind);
    page.age = content.age_ms === null ? null : { ms: content.age_ms + behind - page.best, at: performance.now() };
    page.problem = content.problem;
  }
}

// Age of the newest cycle, ms; null before the first.
function age() {
  return page.age ? page.age.ms + performance.now() - page.age.at : null;
}

function judge() {
  const ms = age();
  const stale = ms === null || ms > page.staleMs || !link.open;
  document.body.classList.toggle("stale", stale && ms !== null);
  document.body.classList.toggle("waiting", ms === null);
  const banner = byId("banner");
  banner.hidden = !stale;
  write(byId("age"), ms === null ? "–" : ms < 1e4 ? figure(ms, 0) : `${figure(ms / 1e3, 0)}k`);
  write(byId("link"), !link.open ? "page server lost" : page.problem ? "no controller" : stale ? "silent" : "live");
  byId("link").dataset.ok = String(!stale);
  if (!stale) return;
  const seconds = ms === null ? "" : ` ${(ms / 1e3).toFixed(1)} s`;
  if (ms === null) {
    write(banner, link.open ? `NO DATA: waiting for a controller at ${page.endpoint}` : "NO DATA: the page's server does not answer");
  } else if (!link.open) write(banner, `STALE: the page's server does not answer; last cycle${seconds} ago`);
  else write(banner, `STALE: no new cycle for${seconds}; what you see is the past`);
}

let drawnAt = 0;
let cost = null; // of the last drawing with all that the browser did about it; null: not over yet
let readAt = 0;
function frame() {
  requestAnimationFrame(frame);
  const now = performance.now();
  cost ??= now - drawnAt;
  if (now - readAt >= READ_MS) {
    readAt = now;
    strips.read();
  }
  // A slow machine draws less often rather than falling behind with what arrives.
  if (!page.changed || !page.history || now - drawnAt < Math.max(DRAW_MS, 3 * cost)) return;
  const to = page.pausedAt ?? page.history.newest;
  if (to === null) return;
  page.changed = false;
  drawnAt = now;
  cost = null;
  strips.draw(page.history, to, page.seconds);
}

function choose(seconds) {
  page.seconds = seconds;
  page.changed = true;
  for (const button of byId("windows").children) {
    button.setAttribute("aria-pressed", String(Number(button.dataset.seconds) === seconds));
  }
}

function pause() {
  page.pausedAt = page.pausedAt === null ? (page.history?.newest ?? null) : null;
  page.changed = true;
  const button = byId("pause");
  button.setAttribute("aria-pressed", String(page.pausedAt !== null));
  write(button, page.pausedAt === null ? "Pause" : "Paused");
  document.body.classList.toggle("paused", page.pausedAt !== null);
}

function move(share) {
  if (page.pausedAt === null) return;
  page.pausedAt = Math.min(page.history.newest, page.pausedAt + share * page.seconds);
  page.changed = true;
}

function nextTheme() {
  const root = document.documentElement;
  const theme = THEMES[(THEMES.indexOf(root.dataset.theme ?? "") + 1) % THEMES.length];
  if (theme) root.dataset.theme = theme;
  else delete root.dataset.theme;
  localStorage.setItem("servohil.theme", theme);
  nameTheme();
  strips.redraw();
}

function nameTheme() {
  write(byId("theme"), { light: "Light", dark: "Dark" }[document.documentElement.dataset.theme] ?? "Auto");
}

for (const [seconds, label] of WINDOWS) {
  const button = byId("windows").appendChild(document.createElement("button"));
  button.textContent = label;
  button.dataset.seconds = seconds;
  button.onclick = () => choose(seconds);
}
byId("pause").onclick = pause;
byId("theme").onclick = nextTheme;
byId("help-button").onclick = () => byId("help").showModal();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => strips.redraw());

addEventListener("keydown", (event) => {
  if (event.key === "Escape") {
    operator.estop();
    return;
  }
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest("input, dialog")) return;
  if (event.key === " " && event.target.closest("button")) return; // presses it
  const number = Number(event.key);
  const keys = {
    " ": pause, p: pause, t: nextTheme, a: () => operator.command("acknowledge"),
    "?": () => byId("help").showModal(), ArrowLeft: () => move(-0.25), ArrowRight: () => move(0.25),
  };
  if (number >= 1 && number <= WINDOWS.length && event.key.length === 1) choose(WINDOWS[number - 1][0]);
  else if (keys[event.key] ?? keys[event.key.toLowerCase()]) (keys[event.key] ?? keys[event.key.toLowerCase()])();
  else return;
  event.preventDefault();
});

nameTheme();
choose(page.seconds);
setInterval(judge, 50);
requestAnimationFrame(frame);
