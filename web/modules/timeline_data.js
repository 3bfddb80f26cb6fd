// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** What /api/timeline and /api/marks answered, as a canvas draws it. */

/**
 * @typedef {object} Scale
 * @property {bigint} start Of the first cell, ns.
 * @property {bigint} step Length of a cell, ns.
 * @property {number} cells How many.
 */

/**
 * @typedef {object} Loss
 * @property {bigint} start
 * @property {bigint} end
 * @property {number | null} count null: nobody knows.
 * @property {string} text Why.
 */

/**
 * @typedef {object} Run
 * @property {string} run Its name, or its id.
 * @property {number} id
 * @property {string} node
 * @property {bigint} first
 * @property {bigint} last
 * @property {number} messages
 */

/** A topic of a robot: how many messages lie in each cell. */
export class Lane {
  /** @param {string} topic @param {string} node */
  constructor(topic, node) {
    this.topic = topic;
    this.node = node;
    /** @type {string[]} */
    this.types = [];
    this.messages = 0;
    this.bytes = 0;
    this.exact = true;
    this.writing = false;
    /** @type {Scale | null} */
    this.scale = null;
    this.counts = new Float64Array(0);
    this.most = 0;
    /** @type {[number, number][]} */
    this.even = [];
    /** @type {[number, number][]} */
    this.unknown = [];
    /** @type {[bigint, bigint][]} */
    this.gaps = [];
    /** @type {Loss[]} */
    this.losses = [];
  }

  get key() {
    return keyOf(this.topic, this.node);
  }

  /**
   * Take what the server says of it.
   * @param {any} said
   * @param {Scale | null} scale
   * @param {boolean} [keep] The cells that it has, for those are finer.
   */
  take(said, scale, keep = false) {
    this.types = said.types;
    this.messages = said.messages;
    this.bytes = said.bytes;
    this.exact = said.exact;
    this.writing = said.writing;
    if (keep && this.scale) return;
    this.scale = scale;
    this.counts = new Float64Array(scale?.cells ?? 0);
    for (const [first, ...counts] of said.counts ?? []) this.counts.set(counts, first);
    this.most = this.counts.reduce((most, count) => Math.max(most, count), 0);
    this.even = said.even ?? [];
    this.unknown = said.unknown ?? [];
    this.gaps = (said.gaps ?? []).map((/** @type {string[]} */ gap) => gap.map(BigInt));
  }

  /** Forget what its cells hold. */
  clear() {
    this.counts = new Float64Array(0);
    this.scale = null;
    this.even = [];
    this.unknown = [];
    this.gaps = [];
  }

  /** @param {bigint} ns @returns {number} The cell of a time; -1 outside. */
  cellOf(ns) {
    if (!this.scale || ns < this.scale.start) return -1;
    const cell = Number((ns - this.scale.start) / this.scale.step);
    return cell < this.scale.cells ? cell : -1;
  }

  /** @param {bigint} ns How many messages lie in the cell of a time. */
  countAt(ns) {
    const cell = this.cellOf(ns);
    return cell < 0 ? 0 : this.counts[cell];
  }

  /** @param {bigint} ns Whether they are spread evenly there, for more is not known. */
  isEven(ns) {
    const cell = this.cellOf(ns);
    return this.even.some(([first, last]) => first <= cell && cell <= last);
  }
}

/** @param {string} topic @param {string} node */
export function keyOf(topic, node) {
  return `${node}\n${topic}`;
}

/** All that a timeline shows. */
export class Picture {
  constructor() {
    /** @type {bigint | null} Of all that is chosen. */
    this.first = null;
    /** @type {bigint | null} */
    this.last = null;
    /** @type {Map<string, Lane>} */
    this.byKey = new Map();
    /** @type {Run[]} */
    this.runs = [];
    /** @type {any[]} */
    this.marks = [];
    /** @type {Lane} Of all lanes together, over all time. */
    this.whole = new Lane("", "");
  }

  /** @returns {Lane[]} By robot and topic. */
  get lanes() {
    return [...this.byKey.values()];
  }

  get writing() {
    return this.lanes.some((lane) => lane.writing);
  }

  /**
   * Take an answer of /api/timeline.
   * @param {any} answer
   * @param {{all?: boolean, whole?: boolean, topics?: string[], nodes?: string[]}} of all: it has all lanes, those that it
   *   lacks are gone; whole: its window is all time; topics, nodes: what was asked for, none = all.
   */
  take(answer, { all = false, whole = false, topics = [], nodes = [] }) {
    const scale = scaleOf(answer);
    const before = this.byKey;
    for (const lane of all ? [] : this.lanes) {
      // Of a run there are only the lanes in which it has something.
      const asked = !topics.length || topics.includes(lane.topic);
      if (asked && (!nodes.length || nodes.includes(lane.node))) lane.clear();
    }
    if (all) {
      this.byKey = new Map();
      this.first = bigOrNull(answer.first);
      this.last = bigOrNull(answer.last);
    }
    for (const said of answer.lanes) {
      const key = keyOf(said.topic, said.node);
      const lane = before.get(key) ?? new Lane(said.topic, said.node);
      lane.take(said, scale, all);
      this.byKey.set(key, lane);
    }
    if (all) this.runs = answer.runs.map(runOf);
    if (whole) this.whole.take(sumOf(answer.lanes, scale), scale);
  }

  /**
   * Take an answer of /api/marks: losses go to their lanes, which are made where nothing is stored.
   * @param {any[]} marks
   */
  takeMarks(marks) {
    this.marks = marks.map((mark) => ({ ...mark, start: BigInt(mark.start), end: BigInt(mark.end) }));
    for (const lane of this.lanes) lane.losses = [];
    for (const mark of this.marks.filter((each) => each.kind === "loss")) {
      const key = keyOf(mark.topic, mark.node);
      const lane = this.byKey.get(key) ?? new Lane(mark.topic, mark.node);
      this.byKey.set(key, lane);
      lane.losses.push(mark);
    }
    const ordered = [...this.byKey].sort(([one], [other]) => (one < other ? -1 : 1));
    this.byKey = new Map(ordered);
  }
}

/** @param {any} run @returns {Run} */
function runOf(run) {
  return { ...run, first: BigInt(run.first), last: BigInt(run.last) };
}

/** @param {string | null} text */
function bigOrNull(text) {
  return text === null ? null : BigInt(text);
}

/** @param {any} answer @returns {Scale | null} */
function scaleOf(answer) {
  if (answer.start === null) return null;
  return { start: BigInt(answer.start), step: BigInt(answer.cell_ns), cells: answer.cells };
}

/** @param {any[]} lanes As they are answered. @param {Scale | null} scale */
function sumOf(lanes, scale) {
  const sum = new Array(scale?.cells ?? 0).fill(0);
  for (const said of lanes) {
    const lane = new Lane(said.topic, said.node);
    lane.take(said, scale);
    // Each as high as its own rate allows, or a camera would not be seen beside an IMU.
    if (lane.most) lane.counts.forEach((count, cell) => (sum[cell] += count / lane.most));
  }
  return { types: [], messages: 0, bytes: 0, exact: true, writing: false, counts: [[0, ...sum]] };
}
