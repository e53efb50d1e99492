/** Who looks: the token, kept for this tab or on this device, and what its scope may do. */

const KEY = "brink.token";

/** Do something with a storage, if there is one: without, the token lives as long as the page. */
function stored(name, doing) {
  try {
    return doing(window[name]);
  } catch {
    return null;
  }
}

const STORES = ["sessionStorage", "localStorage"];
let token = STORES.map((name) => stored(name, (store) => store.getItem(KEY))).find(Boolean) ?? null;

/** Return the token that requests carry, or null. */
export function currentToken() {
  return token;
}

/** Take a token for this tab; with ``remember``, for this device. */
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
 * What a scope may do: ``steer`` is to submit, pause, resume, cancel, retry; ``remove`` is to delete for good.
 *
 * @param {string} scope ``read``, ``user``, ``worker`` or ``admin``.
 */
export function rights(scope) {
  return { steer: scope === "user" || scope === "admin", remove: scope === "admin" };
}
