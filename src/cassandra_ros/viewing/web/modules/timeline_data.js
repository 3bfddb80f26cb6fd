// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** The answers of /api/timeline, /api/marks and /api/events in the form that the canvas draws. */

/**
 * @typedef {object} Scale
 * @property {bigint} start Start of the first cell, ns.
 * @property {bigint} step Length of a cell, ns.
 * @property {number} cells Number of cells.
 */

/**
 * @typedef {object} Loss
 * @property {bigint} start
 * @property {bigint} end
 * @property {number | null} count Number of lost messages; null = not known.
 * @property {string} text Reason.
 */

/**
 * @typedef {object} Run
 * @property {string} run Name of the run, or its writer id.
 * @property {number} id
 * @property {string} node
 * @property {bigint} first
 * @property {bigint} last
 * @property {number} messages
 */

/** A topic of a robot, with the number of messages in each cell. */
export class Lane {
  /** @param {string} topic @param {string} node */
  constructor(topic, node) {
    this.topic = topic;
    this.node = node;
    /** @type {string[]} */
    this.types = [];
    /** How its messages are found: "time", a field, or "manual" and "hash" by a name. */
    this.foundBy = "time";
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
    /** @type {[bigint, bigint][]} Time ranges of cells that are not empty. */
    this.filled = [];
    /** @type {Scale | null} Scale of all time. */
    this.all = null;
    /** @type {[bigint, bigint][]} Time ranges of its cells that are not empty. */
    this.coarse = [];
    /** @type {Loss[]} */
    this.losses = [];
  }

  get key() {
    return keyOf(this.topic, this.node);
  }

  /**
   * Take the lane of an answer.
   * @param {any} said
   * @param {Scale | null} scale
   * @param {boolean} [keep] Whether to keep its present cells, which are finer.
   */
  take(said, scale, keep = false) {
    this.types = said.types;
    this.foundBy = said.key ?? this.foundBy;
    this.messages = said.messages;
    this.bytes = said.bytes;
    this.exact = said.exact;
    this.writing = said.writing;
    const filled = filledOf(said, scale);
    if (keep) [this.all, this.coarse] = [scale, filled];
    if (keep && this.scale) return;
    [this.scale, this.filled] = [scale, filled];
    this.counts = new Float64Array(scale?.cells ?? 0);
    for (const [first, ...counts] of said.counts ?? []) this.counts.set(counts, first);
    this.most = this.counts.reduce((most, count) => Math.max(most, count), 0);
    this.even = said.even ?? [];
    this.unknown = said.unknown ?? [];
    this.gaps = (said.gaps ?? []).map((/** @type {string[]} */ gap) => gap.map(BigInt));
  }

  /** Clear its cells. */
  clear() {
    this.counts = new Float64Array(0);
    this.scale = null;
    this.even = [];
    this.unknown = [];
    this.gaps = [];
  }

  /**
   * Return whether messages, or losses, are known in a time range.
   * @param {bigint} start
   * @param {bigint} end
   */
  isIn(start, end) {
    const meets = (/** @type {[bigint, bigint]} */ [low, high]) => low <= end && high >= start;
    if (this.losses.some((loss) => meets([loss.start, loss.end]))) return true;
    if (!this.scale || !this.all || !this.coarse.some(meets)) return false;
    // Cells of a view are finer than those of all time, but end with the view.
    const [first, last] = [this.scale.start, endOf(this.scale)];
    const [low, high] = [this.all.start > start ? this.all.start : start, endOf(this.all) < end ? endOf(this.all) : end];
    return first > low || last < high || this.filled.some(meets);
  }

  /** @param {bigint} ns @returns {number} Index of the cell of a time; -1 = outside. */
  cellOf(ns) {
    if (!this.scale || ns < this.scale.start) return -1;
    const cell = Number((ns - this.scale.start) / this.scale.step);
    return cell < this.scale.cells ? cell : -1;
  }

  /** @param {bigint} ns Number of messages in the cell of a time. */
  countAt(ns) {
    const cell = this.cellOf(ns);
    return cell < 0 ? 0 : this.counts[cell];
  }

  /** @param {bigint} ns Whether the messages are spread evenly there because their times are not known. */
  isEven(ns) {
    const cell = this.cellOf(ns);
    return this.even.some(([first, last]) => first <= cell && cell <= last);
  }
}

/** @param {Scale} scale */
function endOf({ start, step, cells }) {
  return start + step * BigInt(cells) - 1n;
}

/**
 * @param {any} said A lane of an answer.
 * @param {Scale | null} scale
 * @returns {[bigint, bigint][]}
 */
function filledOf(said, scale) {
  if (!scale) return [];
  const runs = (said.counts ?? []).map((/** @type {number[]} */ [first, ...counts]) => [first, first + counts.length - 1]);
  const at = (/** @type {number} */ cell) => scale.start + scale.step * BigInt(cell);
  return [...runs, ...(said.unknown ?? [])].map(([first, last]) => [at(first), at(last + 1) - 1n]);
}

/** @param {string} topic @param {string} node */
export function keyOf(topic, node) {
  return `${node}\n${topic}`;
}

/** The data of a timeline. */
export class Picture {
  constructor() {
    /** @type {bigint | null} First time of the selection. */
    this.first = null;
    /** @type {bigint | null} */
    this.last = null;
    /** @type {Map<string, Lane>} */
    this.byKey = new Map();
    /** @type {Run[]} */
    this.runs = [];
    /** @type {any[]} */
    this.marks = [];
    /** @type {any[]} Events in or near the visible time range. */
    this.events = [];
    /** @type {Lane} Sum of all lanes, over all time. */
    this.whole = new Lane("", "");
  }

  /** @returns {Lane[]} Lanes sorted by robot and topic. */
  get lanes() {
    return [...this.byKey.values()];
  }

  get writing() {
    return this.lanes.some((lane) => lane.writing);
  }

  /**
   * Take an answer of /api/timeline.
   * @param {any} answer
   * @param {{all?: boolean, whole?: boolean, topics?: string[], nodes?: string[]}} of all: it has all lanes, other
   *   ones are deleted; whole: it covers all time; topics, nodes: those of the request, none = all.
   */
  take(answer, { all = false, whole = false, topics = [], nodes = [] }) {
    const scale = scaleOf(answer);
    const before = this.byKey;
    for (const lane of all ? [] : this.lanes) {
      // With selected runs the answer has only lanes in which they have messages.
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
      // A part of the time also has lanes of robots whose messages were deleted.
      if (!all && !before.has(key) && said.first === null) continue;
      const lane = before.get(key) ?? new Lane(said.topic, said.node);
      lane.take(said, scale, all);
      this.byKey.set(key, lane);
    }
    if (all) this.runs = answer.runs.map(runOf);
    if (whole) this.whole.take(sumOf(answer.lanes, scale), scale);
  }

  /**
   * Take an answer of /api/events; an event without an end lasts.
   * @param {any[]} events
   */
  takeEvents(events) {
    this.events = events.map((event) => ({
      ...event, start: BigInt(event.start), end: event.end === null ? null : BigInt(event.end),
    }));
  }

  /**
   * Take an answer of /api/marks: losses go to their lanes, which are made if no message is stored.
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

/** @param {any[]} lanes Lanes of the answer. @param {Scale | null} scale */
function sumOf(lanes, scale) {
  const sum = new Array(scale?.cells ?? 0).fill(0);
  for (const said of lanes) {
    const lane = new Lane(said.topic, said.node);
    lane.take(said, scale);
    // Each lane has its own scale: otherwise a camera could not be seen beside an IMU.
    if (lane.most) lane.counts.forEach((count, cell) => (sum[cell] += count / lane.most));
  }
  return { types: [], messages: 0, bytes: 0, exact: true, writing: false, counts: [[0, ...sum]] };
}
