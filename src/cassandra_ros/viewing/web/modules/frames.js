// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * Streams of messages as /api/messages and /api/latest send them: frames of a head (uint32 channel,
 * uint32 size, int64 time in ns, little endian) and size bytes; those of channel 0 are JSON.
 */

import { reader } from "./messages.js";

const HEAD_BYTES = 16;
const CONTROL = 0;
const TEXT = new TextDecoder();

/** @typedef {{id: number, topic: string, type: string, md5sum: string, schema: any}} Channel */
/** @typedef {{topic: string, text: string}} Problem */
/**
 * @typedef {object} Message
 * @property {Channel} channel
 * @property {bigint} time Time, ns.
 * @property {number} size Size, bytes.
 * @property {any} message The message itself.
 */

/**
 * @param {string} store Name of a store that did not answer.
 * @param {unknown} reason
 * @returns {Problem}
 */
export function missingStore(store, reason) {
  return { topic: `store ${store}`, text: `store ${store} did not answer, what only it has is left out: ${reason}` };
}

/**
 * Read a stream while it comes; only the present frame is held in memory.
 * @param {Response} response Response; it is cancelled if reading ends early.
 * @param {(problem: Problem) => void} onProblem Called for each message that cannot be read, and
 *   at the end for each store that did not answer.
 * @returns {AsyncGenerator<Message, string | null>} Returns the cursor of the next page; null =
 *   no message is left.
 * @throws {Error} The stream was cut off.
 */
export async function* messages(response, onProblem) {
  const bytes = new Incoming(response);
  /** @type {Map<number, {channel: Channel, read: (bytes: Uint8Array) => any}>} */
  const channels = new Map();
  try {
    for (;;) {
      const head = await bytes.take(HEAD_BYTES);
      const view = new DataView(head.buffer);
      const id = view.getUint32(0, true);
      const data = await bytes.take(view.getUint32(4, true));
      if (id === CONTROL) {
        const told = JSON.parse(TEXT.decode(data));
        if (told.end) {
          for (const [store, reason] of Object.entries(told.end.missing ?? {})) {
            onProblem(missingStore(store, reason));
          }
          return told.end.next;
        }
        if (told.channel) channels.set(told.channel.id, opened(told.channel));
        if (told.problem) onProblem(told.problem);
        continue;
      }
      const open = channels.get(id);
      if (!open) throw new Error(`the viewer sent a message of channel ${id}, which it did not open`);
      const { channel, read } = open;
      let message;
      try {
        message = read(data);
      } catch (error) {
        if (!(error instanceof RangeError)) throw error;
        onProblem({ topic: channel.topic, text: `a message of ${channel.topic} cannot be read: ${error.message}` });
        continue;
      }
      yield { channel, time: view.getBigInt64(8, true), size: data.length, message };
    }
  } finally {
    await bytes.cancel();
  }
}

/** @type {Map<string, (bytes: Uint8Array) => any>} By schema, which each page of a stream repeats. */
const READERS = new Map();

/** @param {Channel} channel */
function opened(channel) {
  const key = JSON.stringify(channel.schema);
  const read = READERS.get(key) ?? reader(channel.schema);
  READERS.set(key, read);
  return { channel, read };
}

/** The bytes of a response, read in parts of a given size. */
class Incoming {
  /** @param {Response} response */
  constructor(response) {
    if (!response.body) throw new Error("the viewer's answer is empty");
    this.body = response.body.getReader();
    this.chunk = new Uint8Array(0);
    this.at = 0;
  }

  /**
   * @param {number} count
   * @returns {Promise<Uint8Array>} In separate, aligned memory.
   */
  async take(count) {
    const taken = new Uint8Array(count);
    for (let filled = 0; filled < count; ) {
      if (this.at === this.chunk.length) {
        const { done, value } = await this.body.read();
        if (done) throw new Error("the viewer's answer was cut short");
        this.chunk = value;
        this.at = 0;
      }
      const part = this.chunk.subarray(this.at, this.at + count - filled);
      taken.set(part, filled);
      filled += part.length;
      this.at += part.length;
    }
    return taken;
  }

  /** End the request, unless it was read to its end or failed. */
  async cancel() {
    try {
      await this.body.cancel();
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof DOMException)) throw error;
    }
  }
}
