/** The coordinator's API: requests, errors, conditional GET, the token and its rights, and the shapes of responses. */

const BASE = new URL("api/v1/", document.baseURI).pathname;

/** Returned by `Conditional.get` if nothing has changed. */
export const UNCHANGED = Symbol("unchanged");

/** An error response, or no response at all. */
export class ApiError extends Error {
  /**
   * @param {number} status HTTP status; 0 if the coordinator did not respond.
   * @param {string} detail What is wrong.
   * @param {{pointer: string, message: string, nearest: string|null}[]} errors One for each wrong field.
   * @param {string} title The kind of error, such as ``No worker``.
   */
  constructor(status, detail, errors = [], title = "") {
    super(detail);
    this.name = "ApiError";
    this.status = status;
    this.title = title;
    this.errors = errors;
  }

  /** Whether a worker has to be started first. */
  get noWorker() {
    return this.title === "No worker";
  }

  /** Whether a trace is missing that can be requested. */
  get notRecorded() {
    return this.title === "Not recorded";
  }

  /** Whether the error is temporary, so that trying again may help. */
  get passes() {
    return this.status === 0 || this.status === 429 || this.status >= 500; // including responses from a proxy
  }
}

let clockAheadMs = 0;

/** Return the time of the coordinator's clock, in milliseconds since 1970, accurate to about a second. */
export function serverNow() {
  return Date.now() + clockAheadMs;
}

/**
 * Send a request.
 *
 * @param {string} method
 * @param {string} path Below ``/api/v1``, such as ``campaigns?limit=3``.
 * @param {{json?: *, text?: string, headers?: object, etag?: string|null, signal?: AbortSignal}} options ``text`` needs
 *   a ``Content-Type`` header.
 * @returns {Promise<Response>} A response with status 2xx, or 304 if an etag was given.
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
    // The page keeps ETags itself: the browser's cache would turn a 304 into a 200.
    answer = await fetch(BASE + path, { method, headers, body, signal, cache: "no-store", credentials: "omit" });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new ApiError(0, "the coordinator does not respond");
  }
  const date = Date.parse(answer.headers.get("date") ?? "");
  if (Number.isFinite(date) && Math.abs(date - serverNow()) > 2000) clockAheadMs = date - Date.now();
  if (answer.ok || answer.status === 304) return answer;
  throw await refusal(answer);
}

/** Return the body of a response as JSON, text or a blob; a lost connection counts as no response. */
export async function read(answer, as = "json") {
  try {
    return await answer[as]();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, "the coordinator does not respond");
  }
}

function parsed(written) {
  try {
    return JSON.parse(written);
  } catch {
    throw new ApiError(0, "the response is not from the coordinator"); // but from a proxy
  }
}

async function refusal(answer) {
  let told = null;
  try {
    told = await answer.json();
  } catch {
    // from a proxy
  }
  return new ApiError(answer.status, told?.detail ?? `${answer.status} ${answer.statusText}`, told?.errors ?? [], told?.title);
}

/** Return the JSON content of a path. */
export async function get(path, { signal } = {}) {
  return read(await request("GET", path, { signal }));
}

/** Send a request, and return the JSON content of the response, or null if it has none. */
export async function send(method, path, options = {}) {
  const answer = await request(method, path, options);
  return answer.status === 204 ? null : read(answer);
}

/** Conditional GET: remembers the ETag of a path or, if it has none, its content. */
export class Conditional {
  #path = null;
  #etag = null;
  #text = null;

  /** Return the content of a path, or UNCHANGED if it is the same as at the last call. */
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

  /** Forget the ETag, so that the next call returns the content. */
  forget() {
    this.#path = null;
  }
}

/** Save the content of a path as a file. */
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

const KEY = "brink.token";

/** Access a storage if the browser allows it; otherwise the token lives as long as the page. */
function stored(name, doing) {
  try {
    return doing(window[name]);
  } catch {
    return null;
  }
}

const STORES = ["sessionStorage", "localStorage"];
let token = STORES.map((name) => stored(name, (store) => store.getItem(KEY))).find(Boolean) ?? null;

/** Return the token sent with requests, or null. */
export function currentToken() {
  return token;
}

/** Use a token in this tab or, with ``remember``, on this device. */
export function takeToken(given, { remember = false } = {}) {
  dropToken();
  token = given;
  stored(remember ? "localStorage" : "sessionStorage", (store) => store.setItem(KEY, given));
}

/** Forget the token everywhere. */
export function dropToken() {
  token = null;
  for (const name of STORES) stored(name, (store) => store.removeItem(KEY));
}

/**
 * Return what a scope allows: ``steer`` is to submit, pause, resume, cancel and retry; ``remove`` is to delete;
 * ``operate`` is to drain workers.
 *
 * @param {string} scope ``read``, ``user``, ``worker`` or ``admin``.
 */
export function rights(scope) {
  return { steer: scope === "user" || scope === "admin", remove: scope === "admin", operate: scope === "admin" };
}

const OPEN = new Set(["running", "paused"]);

/** All states of campaigns and experiments, open ones first. */
export const STATUSES = [...OPEN, "finished", "cancelled", "failed"];

/** Return whether a campaign or experiment has not ended. */
export function isOpen(status) {
  return OPEN.has(status);
}

/** Return the rows of a columnar response, one object for each entry of its list `key`. */
export function rowsOf(answer, key = "id") {
  const length = answer[key].length;
  const names = Object.keys(answer).filter((name) => Array.isArray(answer[name]) && answer[name].length === length);
  return answer[key].map((_, index) => Object.fromEntries(names.map((name) => [name, answer[name][index]])));
}
