// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * Reads serialised ROS messages into the objects that the Studio's panels expect: time and
 * duration are {sec, nsec}, int64 and uint64 BigInt, arrays of numbers typed arrays.
 *
 * The schema stays data. The Studio's own reader compiles it, so that a recorded definition would run
 * as code.
 */

/**
 * @typedef {object} Field
 * @property {string} name
 * @property {string} type
 * @property {boolean} [isComplex] Whether it is a message of one of the schema's types.
 * @property {boolean} [isArray]
 * @property {number} [arrayLength] Length of an array of fixed length.
 * @property {boolean} [isConstant]
 */
/** @typedef {{root: string, types: Record<string, Field[]>}} Schema */
/** @typedef {(cursor: Cursor) => any} Read */

const TEXT = new TextDecoder();
/** Maximum number of empty elements in a message, in addition to the number of its bytes. */
const MOST_EMPTY = 100_000;

/** A reading position in the bytes of a message. */
class Cursor {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
    /** Number of array elements so far that took no bytes. */
    this.empty = 0;
  }

  /**
   * Move over some bytes; return the position before.
   * @param {number} count
   */
  take(count) {
    const at = this.at;
    if (count > this.bytes.length - at) throw new RangeError(`the message ends at byte ${this.bytes.length}`);
    this.at = at + count;
    return at;
  }

  length() {
    return this.view.getUint32(this.take(4), true);
  }
}

/** @type {Record<string, Read>} */
const PRIMITIVES = {
  bool: (cursor) => cursor.view.getUint8(cursor.take(1)) !== 0,
  int8: (cursor) => cursor.view.getInt8(cursor.take(1)),
  uint8: (cursor) => cursor.view.getUint8(cursor.take(1)),
  int16: (cursor) => cursor.view.getInt16(cursor.take(2), true),
  uint16: (cursor) => cursor.view.getUint16(cursor.take(2), true),
  int32: (cursor) => cursor.view.getInt32(cursor.take(4), true),
  uint32: (cursor) => cursor.view.getUint32(cursor.take(4), true),
  int64: (cursor) => cursor.view.getBigInt64(cursor.take(8), true),
  uint64: (cursor) => cursor.view.getBigUint64(cursor.take(8), true),
  float32: (cursor) => cursor.view.getFloat32(cursor.take(4), true),
  float64: (cursor) => cursor.view.getFloat64(cursor.take(8), true),
  time: (cursor) => {
    const at = cursor.take(8);
    return { sec: cursor.view.getUint32(at, true), nsec: cursor.view.getUint32(at + 4, true) };
  },
  duration: (cursor) => {
    const at = cursor.take(8);
    return { sec: cursor.view.getInt32(at, true), nsec: cursor.view.getInt32(at + 4, true) };
  },
  string: (cursor) => {
    const size = cursor.length();
    const at = cursor.take(size);
    return TEXT.decode(cursor.bytes.subarray(at, at + size));
  },
};

/** @type {Record<string, any>} */
const ARRAYS = {
  int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array, int32: Int32Array,
  uint32: Uint32Array, int64: BigInt64Array, uint64: BigUint64Array, float32: Float32Array,
  float64: Float64Array,
};

/**
 * Return a function that reads the messages of a type.
 * @param {Schema} schema
 * @returns {(bytes: Uint8Array) => any} Throws a RangeError if the bytes are no such message.
 *   Arrays of numbers may share the memory of the bytes.
 */
export function reader(schema) {
  /** @type {Map<string, Read>} */
  const made = new Map();
  const read = readMessage(schema.root, schema, made);
  return (bytes) => {
    const cursor = new Cursor(bytes);
    const message = read(cursor);
    if (cursor.at !== bytes.length) {
      throw new RangeError(`the message has ${bytes.length} bytes, its type ${cursor.at}`);
    }
    return message;
  };
}

/**
 * @param {string} type
 * @param {Schema} schema
 * @param {Map<string, Read>} made
 * @returns {Read}
 */
function readMessage(type, schema, made) {
  const known = made.get(type);
  if (known) return known;
  const fields = schema.types[type].filter((field) => !field.isConstant);
  const names = fields.map((field) => field.name);
  const reads = fields.map((field) => readField(field, schema, made));
  /** @type {Read} */
  const read = (cursor) => {
    /** @type {Record<string, any>} */
    const message = {};
    for (let index = 0; index < names.length; index++) message[names[index]] = reads[index](cursor);
    return message;
  };
  made.set(type, read);
  return read;
}

/**
 * @param {Field} field
 * @param {Schema} schema
 * @param {Map<string, Read>} made
 * @returns {Read}
 */
function readField(field, schema, made) {
  const one = field.isComplex ? readMessage(field.type, schema, made) : PRIMITIVES[field.type];
  if (!field.isArray) return one;
  const fixed = field.arrayLength;
  const Numbers = field.isComplex ? undefined : ARRAYS[field.type];
  if (Numbers) return (cursor) => numbers(cursor, Numbers, fixed ?? cursor.length());
  return (cursor) => {
    const count = fixed ?? cursor.length();
    const found = [];
    for (let index = 0; index < count; index++) {
      const before = cursor.at;
      found.push(one(cursor));
      if (cursor.at !== before) continue;
      // An empty message takes no bytes, so the size of the message does not limit their number.
      const size = cursor.bytes.length;
      cursor.empty++;
      if (cursor.empty > size + MOST_EMPTY || (fixed === undefined && index > size)) {
        throw new RangeError(`an array claims ${count} empty messages`);
      }
    }
    return found;
  };
}

/**
 * @param {Cursor} cursor
 * @param {any} Numbers Class of a typed array.
 * @param {number} count
 */
function numbers(cursor, Numbers, count) {
  const size = count * Numbers.BYTES_PER_ELEMENT;
  const at = cursor.take(size);
  const start = cursor.bytes.byteOffset + at;
  if (start % Numbers.BYTES_PER_ELEMENT === 0) return new Numbers(cursor.bytes.buffer, start, count);
  return new Numbers(cursor.bytes.slice(at, at + size).buffer);
}
