// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause
// @ts-check
/** Requests to the viewer's server. They throw ApiError, whose message can be shown to the user. */

import { written } from "./times.js";

/** @typedef {string | number | bigint | boolean | null | undefined} Value */
/** @typedef {Record<string, Value | readonly Value[]>} Parameters */

/** Event of the window: one of several stores did not answer; its detail has `store` and `reason`. */
export const MISSING = "cassandra-missing";

/** An error that the server answered, or a missing answer. */
export class ApiError extends Error {
  /**
   * @param {string} kind Name of the server's error, as `TopicNotFound`.
   * @param {string} text Cause, place and remedy.
   * @param {number} status HTTP status; 0 = no answer.
   * @param {number} [position] Position of the error in a statement, characters.
   */
  constructor(kind, text, status, position) {
    super(text);
    this.name = kind;
    this.status = status;
    this.position = position;
  }
}

/**
 * Return the address of a path with parameters; missing, empty and false ones are left out.
 * A list becomes one parameter, with commas; a bigint is a time, ns since 1970.
 * @param {string} path
 * @param {Parameters} [parameters]
 * @returns {string}
 */
export function url(path, parameters = {}) {
  const parts = [];
  for (const [name, given] of Object.entries(parameters)) {
    const value = Array.isArray(given) ? given.join(",") : typeof given === "bigint" ? written(given) : given;
    if (value !== null && value !== undefined && value !== "" && value !== false) {
      parts.push(`${encodeURIComponent(name)}=${readable(String(value))}`);
    }
  }
  return parts.length ? `${path}?${parts.join("&")}` : path;
}

/** @type {string | null} */
let chosen = null;

/** Keyspace in the page's address when it was opened; "" = that of the viewer. */
export function keyspace() {
  // Look gives the address to the Studio later.
  chosen ??= new URLSearchParams(location.search).get("keyspace") ?? "";
  return chosen;
}

/**
 * Send a request and return the response once its head has come; its body can be read as a stream.
 * @param {string} path
 * @param {Parameters} [parameters]
 * @param {RequestInit} [options] Options of fetch; `signal` ends the request.
 * @returns {Promise<Response>}
 * @throws {ApiError}
 */
export async function ask(path, parameters = {}, options = {}) {
  let response;
  try {
    response = await fetch(url(path, { keyspace: keyspace(), ...parameters }), { credentials: "same-origin", ...options });
  } catch (error) {
    if (error instanceof TypeError) {
      throw new ApiError(
        "NoAnswer",
        "The viewer does not answer. Does `rosrun cassandra_ros viewer` still run?",
        0,
      );
    }
    throw error;
  }
  if (!response.ok) throw await failure(response);
  return response;
}

/**
 * Request JSON.
 * @param {string} path
 * @param {Parameters} [parameters]
 * @param {RequestInit} [options]
 * @returns {Promise<any>}
 * @throws {ApiError}
 */
export async function get(path, parameters = {}, options = {}) {
  const answer = await (await ask(path, parameters, options)).json();
  for (const [store, reason] of Object.entries(answer.missing ?? {})) {
    window.dispatchEvent(new CustomEvent(MISSING, { detail: { store, reason } }));
  }
  return answer;
}

/**
 * Send a request that changes what is stored.
 * @param {string} path
 * @param {Parameters} parameters
 * @returns {Promise<any>}
 * @throws {ApiError}
 */
export async function send(path, parameters) {
  return (await ask(path, parameters, { method: "POST" })).json();
}

/**
 * Return whether a request ended because it was aborted.
 * @param {unknown} error
 */
export function isAbort(error) {
  return error instanceof DOMException && error.name === "AbortError";
}

/** @param {string} text Escaped as little as possible: people read and send addresses. */
function readable(text) {
  return encodeURIComponent(text)
    .replaceAll("%2F", "/")
    .replaceAll("%2C", ",")
    .replaceAll("%3A", ":");
}

/** @param {Response} response */
async function failure(response) {
  const text = await response.text();
  try {
    const said = JSON.parse(text);
    if (typeof said.text === "string") {
      return new ApiError(said.error, said.text, response.status, said.position);
    }
  } catch (error) {
    if (!(error instanceof SyntaxError)) throw error;
  }
  const what = text.trim().slice(0, 500) || response.statusText;
  return new ApiError("HttpError", `The viewer answered ${response.status}: ${what}`, response.status);
}
