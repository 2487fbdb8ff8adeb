// What the page remembers of each column: everything for the shortest window, extrema of buckets of time for each longer
// one, so that every window has about 1200 points: what a screen can show, and what a slow machine can draw.

const LEVELS = [
  { bucket: 0, window: 5 },
  { bucket: 0.016, window: 10 },
  { bucket: 0.05, window: 30 },
  { bucket: 0.1, window: 60 },
  { bucket: 0.5, window: 300 },
  { bucket: 1, window: 600 },
];
const KEPT = 3; // windows, to look back in while paused
const POINTS_PER_S = 320; // as the server sends them at most

// Times and columns in buffers of twice the capacity: a window is a view of them, never a copy.
class Track {
  constructor(width, capacity) {
    this.capacity = capacity;
    this.t = new Float64Array(2 * capacity);
    this.columns = Array.from({ length: width }, () => new Float32Array(2 * capacity));
    this.start = this.end = 0;
  }

  clear() {
    this.start = this.end = 0;
  }

  push(t, values) {
    if (this.end === 2 * this.capacity) {
      const keep = this.capacity - 1;
      this.t.copyWithin(0, this.end - keep, this.end);
      for (const column of this.columns) column.copyWithin(0, this.end - keep, this.end);
      this.start = 0;
      this.end = keep;
    }
    this.t[this.end] = t;
    for (let i = 0; i < values.length; i++) this.columns[i][this.end] = values[i];
    this.end += 1;
    if (this.end - this.start > this.capacity) this.start = this.end - this.capacity;
  }

  // First place in [start, end) with a time >= t.
  place(t) {
    let low = this.start;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.t[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

// Collects samples and hands on the extrema of each bucket of time.
class Extrema {
  constructor(width, bucket, track) {
    this.bucket = bucket;
    this.track = track;
    this.number = null;
    for (const name of ["low", "high", "first", "last"]) this[name] = new Float32Array(width);
  }

  push(t, values) {
    const number = Math.floor(t / this.bucket);
    if (number !== this.number) {
      this.flush();
      this.number = number;
      this.from = t;
      for (const part of [this.low, this.high, this.first]) part.set(values);
    }
    this.to = t;
    for (let i = 0; i < values.length; i++) {
      const value = values[i];
      // A comparison with NaN is false, so a gap at the bucket's beginning has to give way.
      if (value < this.low[i] || Number.isNaN(this.low[i])) this.low[i] = value;
      if (value > this.high[i] || Number.isNaN(this.high[i])) this.high[i] = value;
    }
    this.last.set(values);
  }

  flush() {
    if (this.number === null) return;
    const before = this.low.slice();
    const after = this.high.slice();
    for (let i = 0; i < before.length; i++) {
      if (this.last[i] < this.first[i]) [before[i], after[i]] = [after[i], before[i]];
    }
    this.track.push(this.from, before);
    if (this.to > this.from) this.track.push(this.to, after);
    this.number = null;
  }
}

export class History {
  // names: of the columns as the server sends them; factors: from SI to what is plotted, by name.
  constructor(names, factors) {
    this.names = names;
    this.factors = names.map((name) => factors[name] ?? 1);
    this.newest = null;
    this.tracks = LEVELS.map(({ bucket, window }) => {
      const rate = bucket ? 2 / bucket : POINTS_PER_S;
      return new Track(names.length, Math.ceil(rate * window * KEPT));
    });
    this.extrema = LEVELS.slice(1).map(({ bucket }, i) => new Extrema(names.length, bucket, this.tracks[i + 1]));
  }

  // A binary block: "HILV", version, n, k; n float64 times; k times n float32.
  take(buffer) {
    const head = new DataView(buffer);
    const magic = head.getUint32(0, false);
    const n = head.getUint32(8, true);
    const k = head.getUint32(12, true);
    if (magic !== 0x48494c56 || head.getUint32(4, true) !== 1 || k !== this.names.length) {
      throw new Error(`a block of another version: ${k} columns, expected ${this.names.length}`);
    }
    const t = new Float64Array(buffer, 16, n);
    const columns = Array.from({ length: k }, (_, i) => new Float32Array(buffer, 16 + 8 * n + 4 * n * i, n));
    if (n && this.newest !== null && t[n - 1] < this.newest) this.clear(); // a new run
    const values = new Float32Array(k);
    for (let j = 0; j < n; j++) {
      if (this.newest !== null && t[j] <= this.newest) continue; // known from the greeting
      for (let i = 0; i < k; i++) values[i] = columns[i][j] * this.factors[i];
      this.tracks[0].push(t[j], values);
      for (const extrema of this.extrema) extrema.push(t[j], values);
      this.newest = t[j];
    }
  }

  clear() {
    this.newest = null;
    for (const track of this.tracks) track.clear();
    for (const extrema of this.extrema) extrema.number = null;
  }

  // [times, column, ...] between two times, with one point more on either side.
  window(names, from, to) {
    const track = this.tracks[LEVELS.findIndex(({ window }) => to - from <= window + 1e-6)];
    const first = Math.max(track.start, track.place(from) - 1);
    const last = Math.min(track.end, track.place(to) + 1);
    return [track.t, ...names.map((name) => track.columns[this.names.indexOf(name)])].map((a) => a.subarray(first, last));
  }
}
