// The plots: one strip per quantity on one time axis, one cursor through all of them.

import { figure, write } from "./quantities.js";

const AXIS_WIDTH = 58;
const TIME_AXIS = 26;
const LOOK_BACK = 10; // points

// Colours of the theme, looked up once: to ask the browser in every stroke makes it compute the page's style each time.
const colors = new Map();
function css(name) {
  if (!colors.has(name)) {
    colors.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  }
  return colors.get(name);
}

const STATISTICS = {
  change: {
    label: "change",
    unit: "2 ln Λ",
    series: [
      { name: "change_statistic", label: "statistic", color: "--plot-a", digits: 1, width: 8 },
      { name: "change_threshold", label: "threshold", color: "--limit", digits: 1, width: 7 },
    ],
    decades: true,
    least: 100,
  },
  cusum: {
    label: "CUSUM",
    unit: "σ",
    series: [
      { name: "cusum_a", label: "A", color: "--plot-a", digits: 1, width: 7 },
      { name: "cusum_b", label: "B", color: "--plot-b", digits: 1, width: 7 },
      { name: "cusum_threshold", label: "threshold", color: "--limit", digits: 1, width: 7 },
    ],
    decades: true,
    least: 100,
  },
  residual: {
    label: "residual",
    unit: "bar",
    series: [
      { name: "residual_a_pa", label: "A", color: "--plot-a", digits: 2, width: 6 },
      { name: "residual_b_pa", label: "B", color: "--plot-b", digits: 2, width: 6 },
      { name: "threshold_a_pa", label: "threshold A", color: "--limit", digits: 2, width: 5 },
      { name: "threshold_b_pa", label: "B", color: "--limit", digits: 2, width: 5 },
    ],
    decades: false,
    least: 1,
  },
};

// A statistic jumps from one to thousands: from LINEAR upwards its axis counts decades.
const LINEAR = 10;
const DECADES = [0, 100, 1e3, 1e4, 1e5, 1e6, 1e7];

const STRIPS = [
  {
    title: "Position", unit: "mm", least: 10, grow: 1.15,
    series: [
      { name: "ref_position_m", label: "reference", color: "--reference", line: 4, digits: 2, width: 7 },
      { name: "position_m", label: "measured", color: "--plot-a", digits: 2, width: 7 },
    ],
  },
  {
    title: "Velocity", unit: "mm/s", least: 20, grow: 1,
    series: [
      { name: "ref_velocity_mps", label: "reference", color: "--reference", line: 4, digits: 1, width: 7 },
      { name: "est_velocity_mps", label: "estimated", color: "--plot-a", digits: 1, width: 7 },
    ],
  },
  {
    title: "Pressure", unit: "bar", least: 5, grow: 1.3,
    series: [
      { name: "pressure_a_pa", label: "A measured", color: "--plot-a-faint", digits: 2, width: 6 },
      { name: "est_pressure_a_pa", label: "estimated", color: "--plot-a", digits: 2, width: 6 },
      { name: "pressure_b_pa", label: "B measured", color: "--plot-b-faint", digits: 2, width: 6 },
      { name: "est_pressure_b_pa", label: "estimated", color: "--plot-b", digits: 2, width: 6 },
      { name: "high_pressure_a_pa", band: "--band-a" },
      { name: "low_pressure_a_pa" },
      { name: "high_pressure_b_pa", band: "--band-b" },
      { name: "low_pressure_b_pa" },
    ],
    note: "band ±2σ",
  },
  {
    title: "Valve", unit: "V", least: 1, grow: 1,
    series: [
      { name: "law_v", label: "asked by law", color: "--reference", line: 4, digits: 2, width: 6 },
      { name: "spool_v", label: "spool", color: "--plot-b", digits: 2, width: 6 },
      { name: "command_v", label: "command", color: "--plot-a", digits: 2, width: 6 },
    ],
  },
  { title: "Leak statistic", choices: STATISTICS, ...STATISTICS.change, grow: 1 },
];

// A range that holds still: ends on a round step and no narrower than `least`. NaN is no value and asks for no room.
function steady(columns, { least, decades }) {
  let low = Infinity;
  let high = -Infinity;
  for (const column of columns) {
    for (const value of column) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [0, least];
  if (decades) return [0, DECADES.find((decade) => decade >= Math.max(least, high)) ?? high];
  const middle = (low + high) / 2;
  const half = Math.max(high - low, least) * 0.54;
  const rough = half / 3;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= rough) * power;
  return [Math.floor((middle - half) / step) * step, Math.ceil((middle + half) / step) * step];
}

class Strip {
  constructor(parent, facts, isLast, onCursor) {
    this.facts = facts;
    this.isLast = isLast;
    this.onCursor = onCursor;
    this.span = this.room = [0, 1];
    this.element = document.createElement("article");
    this.element.className = "strip";
    this.element.style.flexGrow = facts.grow;
    this.head = this.element.appendChild(document.createElement("header"));
    this.place = this.element.appendChild(document.createElement("div"));
    this.place.className = "plot";
    parent.append(this.element);
    this.build();
  }

  build() {
    const { facts } = this;
    this.plot?.destroy();
    this.names = facts.series.map((s) => s.name);
    this.writeHead();
    const bands = facts.series.flatMap((s, i) => (s.band ? [{ series: [i + 1, i + 2], fill: () => css(s.band) }] : []));
    const axis = { stroke: () => css("--axis"), font: "11px system-ui, sans-serif", ticks: { show: false } };
    const ticks = facts.decades ? { splits: () => DECADES.filter((decade) => decade <= this.room[1]), filter: (_, at) => at } : {};
    const grid = { stroke: () => css("--grid"), width: 1 };
    this.plot = new uPlot(
      {
        width: 400,
        height: 100,
        padding: [5, 14, this.isLast ? 0 : 5, 0],
        legend: { show: false },
        cursor: { sync: { key: "servohil" }, drag: { x: false, y: false }, y: false, points: { size: 5 } },
        scales: {
          x: { time: false, range: () => this.span },
          y: { range: () => this.room, ...(facts.decades ? { distr: 4, asinh: LINEAR } : {}) },
        },
        axes: [
          { ...axis, show: this.isLast, size: TIME_AXIS, grid, gap: 4, space: 70, values: (_, at) => at.map((t) => `${+t.toFixed(3)} s`) },
          { ...axis, ...ticks, size: AXIS_WIDTH, grid, gap: 6, space: 26, values: (_, at) => at.map((v) => `${+v.toPrecision(6)}`.replace("-", "−")) },
        ],
        series: [
          {},
          ...facts.series.map((s) => ({
            stroke: s.color ? () => css(s.color) : undefined,
            width: s.color ? (s.line ?? 1.5) : 0,
            points: { show: false },
            spanGaps: false,
          })),
        ],
        bands,
        hooks: { setCursor: [(u) => this.onCursor(u.cursor.idx)] },
      },
      [[], ...this.names.map(() => [])],
      this.place,
    );
    this.resize();
  }

  writeHead() {
    const { facts } = this;
    this.head.replaceChildren();
    const title = this.head.appendChild(document.createElement("h2"));
    title.textContent = facts.title;
    const unit = title.appendChild(document.createElement("span"));
    unit.textContent = facts.unit;
    if (facts.choices) this.head.append(this.choices());
    const legend = this.head.appendChild(document.createElement("ul"));
    this.values = facts.series.map((s) => {
      if (!s.label) return null;
      const item = legend.appendChild(document.createElement("li"));
      const mark = item.appendChild(document.createElement("i"));
      mark.style.setProperty("--mark", `var(${s.color})`);
      mark.style.setProperty("--width", `${s.line ?? 1.5}px`);
      item.append(s.label);
      const value = item.appendChild(document.createElement("b"));
      value.style.minWidth = `${s.width}ch`;
      value.dataset.series = s.name;
      return value;
    });
    if (facts.note) {
      const note = legend.appendChild(document.createElement("li"));
      note.className = "note";
      note.textContent = facts.note;
    }
  }

  choices() {
    const group = document.createElement("div");
    group.className = "segments small";
    for (const choice of Object.values(this.facts.choices)) {
      const button = group.appendChild(document.createElement("button"));
      button.textContent = choice.label;
      button.setAttribute("aria-pressed", String(choice.unit === this.facts.unit));
      button.onclick = () => {
        Object.assign(this.facts, choice);
        this.build();
        this.onCursor(null);
      };
    }
    return group;
  }

  resize() {
    const { clientWidth, clientHeight } = this.place;
    if (clientWidth && clientHeight) this.plot.setSize({ width: clientWidth, height: clientHeight });
  }

  draw(history, span) {
    this.span = span;
    const data = history.window(this.names, span[0], span[1]);
    this.room = steady(data.slice(1), this.facts);
    this.plot.setData(data);
  }

  // The values under the cursor, or the newest ones; a cycle without this signal shows the one before.
  read(index) {
    const data = this.plot.data;
    const at = index ?? data[0].length - 1;
    this.facts.series.forEach((s, i) => {
      if (!this.values[i]) return;
      const column = data[i + 1];
      let place = at;
      while (place > Math.max(0, at - LOOK_BACK) && Number.isNaN(column[place])) place -= 1;
      write(this.values[i], figure(column[place], s.digits));
    });
  }
}

export class Strips {
  constructor(parent) {
    this.cursor = null;
    this.strips = STRIPS.map((facts, i) => {
      return new Strip(parent, facts, i === STRIPS.length - 1, (index) => {
        this.cursor = index;
      });
    });
    new ResizeObserver(() => this.strips.forEach((strip) => strip.resize())).observe(parent);
  }

  draw(history, to, seconds) {
    for (const strip of this.strips) strip.draw(history, [to - seconds, to]);
  }

  read() {
    for (const strip of this.strips) strip.read(this.cursor);
  }

  // After a change of theme: colours are read anew.
  redraw() {
    colors.clear();
    for (const strip of this.strips) strip.plot.redraw(false, true);
  }
}
