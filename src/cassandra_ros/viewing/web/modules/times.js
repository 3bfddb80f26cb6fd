// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/**
 * Times: nanoseconds since 1970 as BigInt, because JavaScript's numbers cannot hold them.
 * Texts are in UTC, as everywhere in cassandra_ros.
 */

export const MICROSECOND = 1_000n;
export const MILLISECOND = 1_000_000n;
export const SECOND = 1_000_000_000n;
export const MINUTE = 60n * SECOND;
export const HOUR = 60n * MINUTE;
export const DAY = 24n * HOUR;
/** Approximate lengths to choose a scale; the exact ones come from the calendar. */
const MONTH = 30n * DAY;
const YEAR = 365n * DAY;
/** A smaller whole number is in seconds: as nanoseconds it would be 17 minutes after 1970. */
const SECONDS_BELOW = 1_000_000_000_000n;
/** The last time that ROS 1 can express. */
export const LAST = 4_294_967_295_999_999_999n;

const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
const ISO =
  /^(\d{4})-(\d\d)-(\d\d)(?:[Tt ](\d\d):(\d\d)(?::(\d\d)(?:[.,](\d{1,9}))?)?\s*([Zz]|[+-]\d\d(?::?\d\d)?)?)?$/;

/**
 * Read a time as on the command line: digits are seconds, from 13 digits on nanoseconds; digits with
 * a point are seconds; other texts are ISO 8601 (no zone means UTC).
 * @param {string} text
 * @returns {bigint}
 * @throws {RangeError} The text is no time, or before 1970 or after 2106.
 */
export function parse(text) {
  const ns = parseAny(text.trim());
  if (ns < 0n || ns > LAST) throw new RangeError(`${text} is not a time from 1970 to 2106`);
  return ns;
}

/** @param {string} text */
function parseAny(text) {
  if (/^\d{1,40}$/.test(text)) {
    const number = BigInt(text);
    return number < SECONDS_BELOW ? number * SECOND : number;
  }
  const seconds = /^(\d{0,40})\.(\d*)$/.exec(text);
  if (seconds && text !== ".") {
    return BigInt(seconds[1] || "0") * SECOND + BigInt(seconds[2].slice(0, 9).padEnd(9, "0"));
  }
  const iso = ISO.exec(text);
  if (!iso) throw new RangeError(`“${text}” is not a time: write it like 2013-05-08T14:06:20.5Z`);
  const [year, month, day, hour, minute, second] = iso.slice(1, 7).map((part) => Number(part ?? 0));
  const ms = Date.UTC(year, month - 1, day, hour, minute, second);
  if (new Date(ms).toISOString().slice(0, 10) !== text.slice(0, 10) || hour > 23 || minute > 59 || second > 59) {
    throw new RangeError(`“${text}” is not a time: the calendar has no such day or hour`);
  }
  return BigInt(ms / 1000) * SECOND - zone(iso[8]) + BigInt((iso[7] ?? "").padEnd(9, "0"));
}

/** @param {string | undefined} text */
function zone(text) {
  if (!text || text === "Z" || text === "z") return 0n;
  const digits = text.slice(1).replace(":", "").padEnd(4, "0");
  const length = BigInt(digits.slice(0, 2)) * HOUR + BigInt(digits.slice(2)) * MINUTE;
  return text[0] === "-" ? -length : length;
}

/**
 * Write a time as ISO 8601 with all its digits, as 2013-05-08T14:06:20.123456789Z.
 * @param {bigint} ns
 */
export function iso(ns) {
  return `${date(ns).toISOString().slice(0, 19)}.${digits(ns, 9)}Z`;
}

/**
 * Write a time for an address, so that parse and the server read the same time: nanoseconds, or for
 * small (simulated) times seconds with a point.
 * @param {bigint} ns
 */
export function written(ns) {
  return ns < SECONDS_BELOW ? `${ns / SECOND}.${digits(ns, 9)}` : String(ns);
}

/**
 * Write a time for people, with the precision of a step in ns.
 * @param {bigint} ns
 * @param {bigint} [step]
 */
export function shown(ns, step = MILLISECOND) {
  const text = date(ns).toISOString().slice(0, 19).replace("T", " ");
  if (step >= DAY) return text.slice(0, 10);
  if (step >= MINUTE) return text.slice(0, 16);
  return text + fraction(ns, step);
}

/**
 * Write a length of time for people, to about three digits, as `1.25 s` or `3 h 20 min`.
 * @param {bigint} ns
 * @returns {string}
 */
export function length(ns) {
  if (ns < 0n) return `−${length(-ns)}`;
  if (ns < MICROSECOND) return `${ns} ns`;
  if (ns < MILLISECOND) return `${short(ns, MICROSECOND)} µs`;
  if (ns < SECOND) return `${short(ns, MILLISECOND)} ms`;
  if (ns < 2n * MINUTE) return `${short(ns, SECOND)} s`;
  if (ns < 2n * HOUR) return pair(ns, MINUTE, "min", SECOND, "s");
  if (ns < 2n * DAY) return pair(ns, HOUR, "h", MINUTE, "min");
  return ns < 60n * DAY ? pair(ns, DAY, "d", HOUR, "h") : `${ns / DAY} d`;
}

/**
 * @typedef {object} Tick
 * @property {bigint} ns
 * @property {string} text
 * @property {boolean} major Whether the next larger unit begins here.
 */

/**
 * Return the ticks of an axis at whole units of the calendar, both ends included.
 * @param {bigint} start
 * @param {bigint} end At least start.
 * @param {number} most Maximum number of ticks, minimum 1.
 * @returns {{step: bigint, ticks: Tick[]}} The step is approximate for months and years.
 */
export function ticks(start, end, most) {
  const least = (end - start) / BigInt(Math.max(1, Math.floor(most))) + 1n;
  const months = MONTH_STEPS.find((n) => BigInt(n) * MONTH >= least) ?? MONTH_STEPS.at(-1) ?? 1;
  const step = STEPS.find((n) => n >= least);
  if (step === undefined) return monthTicks(start, end, months);
  // Weeks begin on Mondays; 1970 began on a Thursday.
  const origin = step >= 7n * DAY ? 4n * DAY : 0n;
  const found = [];
  for (let ns = ceil(start - origin, step) * step + origin; ns <= end; ns += step) {
    if (ns >= 0n) found.push({ ns, text: label(ns, step), major: isMajor(ns, step) });
  }
  return { step, ticks: found };
}

const STEPS = [
  ...[...Array(9).keys()].flatMap((power) => [1n, 2n, 5n].map((n) => n * 10n ** BigInt(power))),
  ...[1n, 2n, 5n, 10n, 15n, 30n].map((n) => n * SECOND),
  ...[1n, 2n, 5n, 10n, 15n, 30n].map((n) => n * MINUTE),
  ...[1n, 2n, 3n, 6n, 12n].map((n) => n * HOUR),
  ...[1n, 2n, 7n, 14n].map((n) => n * DAY),
];
const MONTH_STEPS = [1, 2, 3, 6, 12, 24, 60, 120, 240, 600];

/**
 * @param {bigint} start
 * @param {bigint} end
 * @param {number} months
 */
function monthTicks(start, end, months) {
  const first = date(start < 0n ? 0n : start);
  let index = first.getUTCFullYear() * 12 + first.getUTCMonth();
  index -= index % months;
  const found = [];
  for (; ; index += months) {
    const ns = BigInt(Date.UTC(Math.floor(index / 12), index % 12)) * MILLISECOND;
    if (ns > end) break;
    const january = index % 12 === 0;
    const year = String(Math.floor(index / 12));
    const text = january ? year : MONTHS[index % 12];
    if (ns >= start && ns >= 0n) found.push({ ns, text, major: january && months < 12 });
  }
  return { step: months < 12 ? BigInt(months) * MONTH : BigInt(months / 12) * YEAR, ticks: found };
}

/**
 * @param {bigint} ns
 * @param {bigint} step
 */
function label(ns, step) {
  const at = date(ns);
  if (ns % DAY === 0n) return `${at.getUTCDate()} ${MONTHS[at.getUTCMonth()]}`;
  const text = at.toISOString().slice(11, 19);
  if (step >= MINUTE) return text.slice(0, 5);
  if (step >= SECOND) return text;
  return text.slice(6) + fraction(ns, step);
}

/**
 * @param {bigint} ns
 * @param {bigint} step
 */
function isMajor(ns, step) {
  if (step >= DAY) return date(ns).getUTCDate() === 1;
  if (step >= MINUTE) return ns % DAY === 0n;
  return ns % (step >= SECOND ? MINUTE : SECOND) === 0n;
}

/** @param {bigint} ns */
function date(ns) {
  return new Date(Number(ns / MILLISECOND));
}

/**
 * @param {bigint} ns
 * @param {number} count
 */
function digits(ns, count) {
  return (ns % SECOND).toString().padStart(9, "0").slice(0, count);
}

/**
 * @param {bigint} ns
 * @param {bigint} step
 */
function fraction(ns, step) {
  if (step >= SECOND) return "";
  return `.${digits(ns, step >= MILLISECOND ? 3 : step >= MICROSECOND ? 6 : 9)}`;
}

/**
 * @param {bigint} ns
 * @param {bigint} unit
 */
function short(ns, unit) {
  return String(Number((Number(ns) / Number(unit)).toPrecision(3)));
}

/**
 * @param {bigint} ns
 * @param {bigint} unit
 * @param {string} name
 * @param {bigint} part
 * @param {string} partName
 */
function pair(ns, unit, name, part, partName) {
  const rest = (ns % unit) / part;
  return rest ? `${ns / unit} ${name} ${rest} ${partName}` : `${ns / unit} ${name}`;
}

/**
 * @param {bigint} ns
 * @param {bigint} step
 * @returns {bigint} Number of steps, rounded up.
 */
function ceil(ns, step) {
  const down = ns / step;
  return ns > 0n && ns % step ? down + 1n : down;
}
