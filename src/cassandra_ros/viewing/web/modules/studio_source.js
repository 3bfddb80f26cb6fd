// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * The store as a data source of the Studio (its IIterableSource): messages are requested in pages when
 * they are needed, so that a recording of any length opens at once.
 */

import { ApiError, ask, get, isAbort } from "./api.js";
import { messages, missingStore } from "./frames.js";
import * as times from "./times.js";

const PAGE_BYTES = 4 * 1024 * 1024;
const SMALL_BYTES = 24 * 1024 * 1024;
const SMALL_MESSAGES = 200_000;
const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 10_000;

/** @typedef {{sec: number, nsec: number}} Time Time of the Studio. */
/** @typedef {import("./state.js").State} State */
/** @typedef {{topic: string, message: any, receiveTime: Time, schemaName: string, sizeInBytes: number}} Event */

/** @param {bigint} ns @returns {Time} */
export function toTime(ns) {
  return { sec: Number(ns / times.SECOND), nsec: Number(ns % times.SECOND) };
}

/** @param {Time} time */
export function toNs(time) {
  return BigInt(time.sec) * times.SECOND + BigInt(time.nsec);
}

export class StoreSource {
  /**
   * @param {State} state Selection: start, end, time, topics, nodes, runs.
   * @param {(error: unknown) => void} showError Called with each error before another attempt.
   * @param {(text: string) => void} showNote Called with what is left out, and why.
   */
  constructor(state, showError, showNote) {
    this.state = state;
    this.showError = showError;
    this.showNote = showNote;
    this.chosen = { nodes: state.nodes, runs: state.runs };
    /** @type {any} What /api/connections answered. */
    this.found = null;
    this.start = 0n;
    this.end = 0n;
    /** @type {AbortController | null} Ends the request of the messages that are being played. */
    this.playing = null;
    /** @type {Set<string>} */
    this.told = new Set();
  }

  /** Request the topics; call it before the Studio does, because its layout depends on them. */
  async open() {
    const { start, end, time, topics } = this.state;
    this.found = await get("/api/connections", { topics, start, end, time, ...this.chosen });
    this.start = BigInt(this.found.start);
    this.end = BigInt(this.found.end);
    for (const problem of this.found.problems) this.tell(problem);
    for (const [store, reason] of Object.entries(this.found.missing ?? {})) {
      this.tell(missingStore(store, reason));
    }
    return this.found;
  }

  /** Whether all messages of the time range may be read at once, for curves over all of it. */
  get isSmall() {
    return this.found.bytes <= SMALL_BYTES && this.found.messages <= SMALL_MESSAGES;
  }

  /** @returns {Promise<any>} The Studio's Initalization. */
  async initialize() {
    const { topics } = this.found ?? (await this.open());
    const datatypes = new Map();
    const topicStats = new Map();
    for (const topic of topics) {
      for (const [name, definitions] of Object.entries(topic.schema.types)) {
        datatypes.set(name, { name, definitions });
      }
      topicStats.set(topic.topic, {
        numMessages: topic.messages,
        firstMessageTime: topic.first === null ? undefined : toTime(BigInt(topic.first)),
        lastMessageTime: topic.last === null ? undefined : toTime(BigInt(topic.last)),
      });
    }
    return {
      start: toTime(this.start),
      end: toTime(this.end),
      topics: topics.map((/** @type {any} */ topic) => ({ name: topic.topic, schemaName: topic.type })),
      topicStats,
      datatypes,
      profile: "ros1",
      name: `${times.shown(this.start)} to ${times.shown(this.end)}`,
      publishersByTopic: new Map(),
      problems: [],
    };
  }

  /**
   * Yield the messages of a time range, both ends included, in order.
   * @param {{topics: string[], start?: Time, end?: Time, consumptionType?: "full" | "partial"}} args
   * @returns {AsyncGenerator<{type: "message-event", msgEvent: Event}>}
   */
  async *messageIterator({ topics, start, end, consumptionType }) {
    if (!topics.length || (start && end && toNs(start) > toNs(end))) return;
    const abort = new AbortController();
    if (consumptionType !== "full") this.playing = abort;
    const asked = {
      topics,
      start: start ? toNs(start) : this.start,
      end: end ? toNs(end) : this.end,
      bytes: PAGE_BYTES,
      ...this.chosen,
    };
    try {
      /** @type {string | null} */
      let after = null;
      do {
        const page = this.page("/api/messages", { ...asked, after }, abort.signal);
        let next = await page.next();
        for (; !next.done; next = await page.next()) yield { type: "message-event", msgEvent: next.value };
        after = next.value;
      } while (after !== null);
    } finally {
      abort.abort();
    }
  }

  /**
   * Read one page; if it is cut off, request it again after the last message that came.
   * @param {string} path
   * @param {any} asked
   * @param {AbortSignal} signal
   * @returns {AsyncGenerator<Event, string | null>}
   */
  async *page(path, asked, signal) {
    for (let pause = FIRST_PAUSE_MS, given = 0; ; pause = Math.min(2 * pause, LONGEST_PAUSE_MS)) {
      try {
        const found = messages(await ask(path, asked, { signal }), (each) => this.tell(each));
        let skipped = 0;
        let next = await found.next();
        for (; !next.done; next = await found.next()) {
          if (skipped++ < given) continue;
          given++;
          yield event(next.value);
        }
        return next.value;
      } catch (error) {
        if (isAbort(error) || !isPassing(error)) throw error;
        this.showError(error);
        await wait(pause, signal);
      }
    }
  }

  /**
   * Return the last messages of some topics at or before a time.
   * @param {{topics: string[], time: Time, abortSignal?: AbortSignal}} args
   * @returns {Promise<Event[]>}
   */
  async getBackfillMessages({ topics, time, abortSignal }) {
    if (!topics.length) return [];
    const asked = { topics, time: toNs(time), start: this.start, ...this.chosen };
    const found = [];
    const signal = abortSignal ?? new AbortController().signal;
    for await (const each of this.page("/api/latest", asked, signal)) found.push(each);
    return found;
  }

  /** End the request of the messages that are being played, for a seek. */
  interrupt() {
    this.playing?.abort();
  }

  /** @param {import("./frames.js").Problem} problem Shown once for each topic. */
  tell(problem) {
    if (this.told.has(problem.topic)) return;
    this.told.add(problem.topic);
    this.showNote(problem.text);
  }
}

/**
 * @param {import("./frames.js").Message} found
 * @returns {Event}
 */
function event({ channel, time, size, message }) {
  const { topic, type } = channel;
  return { topic, message, receiveTime: toTime(time), schemaName: type, sizeInBytes: size };
}

/** @param {unknown} error Returns whether another attempt may succeed: not for an invalid request. */
function isPassing(error) {
  return !(error instanceof ApiError) || error.status === 0 || error.status >= 500;
}

/**
 * @param {number} ms
 * @param {AbortSignal} signal Ends the waiting, by its error.
 */
function wait(ms, signal) {
  return new Promise((resolve, reject) => {
    const end = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => {
      clearTimeout(end);
      reject(signal.reason);
    }, { once: true });
  });
}
