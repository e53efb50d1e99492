/** The coordinator's API: JSON in and out, errors as they are told, and 304 as "nothing new". */

import { currentToken } from "./session.js";

const BASE = new URL("api/v1/", document.baseURI).pathname;

/** What `get` returns if nothing is new since the last time. */
export const UNCHANGED = Symbol("unchanged");

/** An answer that says what is wrong. */
export class ApiError extends Error {
  /**
   * @param {number} status Of HTTP; 0 if the coordinator did not answer.
   * @param {string} detail What is wrong.
   * @param {{pointer: string, message: string, nearest: string|null}[]} errors One a wrong field.
   * @param {string} title The kind of error, such as ``No worker``.
   */
  constructor(status, detail, errors = [], title = "") {
    super(detail);
    this.name = "ApiError";
    this.status = status;
    this.title = title;
    this.errors = errors;
  }

  /** Whether somebody has to start a worker first. */
  get noWorker() {
    return this.title === "No worker";
  }

  /** Whether trying again later may help. */
  get passes() {
    return this.status === 0 || this.status === 429 || this.status >= 500; // a proxy has answers of its own
  }
}

let clockAheadMs = 0;

/** The coordinator's clock, in milliseconds since 1970, to a second. */
export function serverNow() {
  return Date.now() + clockAheadMs;
}

/**
 * Ask for something.
 *
 * @param {string} method
 * @param {string} path Below ``/api/v1``, such as ``campaigns?limit=3``.
 * @param {{json?: *, text?: string, headers?: object, etag?: string|null, signal?: AbortSignal}} options A text comes with
 *   its own ``Content-Type``.
 * @returns {Promise<Response>} An answer of 2xx, or 304 if an etag was given.
 * @throws {ApiError}
 */
export async function request(method, path, { json, text, etag, signal, headers: more } = {}) {
  const headers = new Headers(more);
  const token = currentToken();
  if (token) headers.set("Authorization", `Bearer ${token}`);
  if (etag) headers.set("If-None-Match", etag);
  let body;
  if (json !== undefined) {
    headers.set("Content-Type", "application/json");
    body = JSON.stringify(json);
  } else if (text !== undefined) {
    body = text;
  }
  let answer;
  try {
    // The page keeps the tags itself: from its own cache the browser would answer 200 for a 304.
    answer = await fetch(BASE + path, { method, headers, body, signal, cache: "no-store", credentials: "omit" });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new ApiError(0, "the coordinator does not answer");
  }
  const date = Date.parse(answer.headers.get("date") ?? "");
  if (Number.isFinite(date) && Math.abs(date - serverNow()) > 2000) clockAheadMs = date - Date.now();
  if (answer.ok || answer.status === 304) return answer;
  throw await refusal(answer);
}

/** Return what an answer holds, as JSON, text or a blob; a connection that is lost within it is one that was never there. */
export async function read(answer, as = "json") {
  try {
    return await answer[as]();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, "the coordinator does not answer");
  }
}

function parsed(written) {
  try {
    return JSON.parse(written);
  } catch {
    throw new ApiError(0, "what came is not from the coordinator"); // a proxy's
  }
}

async function refusal(answer) {
  let told = null;
  try {
    told = await answer.json();
  } catch {
    // not ours: a proxy's
  }
  return new ApiError(answer.status, told?.detail ?? `${answer.status} ${answer.statusText}`, told?.errors ?? [], told?.title);
}

/** Return what a path holds. */
export async function get(path, { signal } = {}) {
  return read(await request("GET", path, { signal }));
}

/** Send something, and return what is answered, if anything is. */
export async function send(method, path, options = {}) {
  const answer = await request(method, path, options);
  return answer.status === 204 ? null : read(answer);
}

/** Remembers one path's tag, so that what did not change is not sent again; or, if it has none, the answer itself. */
export class Conditional {
  #path = null;
  #etag = null;
  #text = null;

  /** Return what a path holds, or UNCHANGED since the last call for the same path. */
  async get(path, { signal } = {}) {
    const etag = path === this.#path ? this.#etag : null;
    const answer = await request("GET", path, { etag, signal });
    if (answer.status === 304) return UNCHANGED;
    const written = await read(answer, "text");
    if (path === this.#path && written === this.#text) return UNCHANGED;
    const told = parsed(written);
    this.#path = path;
    this.#etag = answer.headers.get("etag");
    this.#text = this.#etag ? null : written;
    return told;
  }

  /** Forget the tag: the next answer is whole. */
  forget() {
    this.#path = null;
  }
}

/** Save what a path holds as a file. */
export async function download(path, name) {
  saveBlob(await read(await request("GET", path), "blob"), name);
}

/** Save data as a file. */
export function saveBlob(blob, name) {
  const url = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
