/** Who looks: the token, kept for this tab or on this device, and what its scope may do. */

const KEY = "brink.token";

function stores() {
  const found = [];
  for (const name of ["sessionStorage", "localStorage"]) {
    try {
      found.push(window[name]);
    } catch {
      // storage is refused: the token lives as long as the page
    }
  }
  return found;
}

let token = stores().map((store) => store.getItem(KEY)).find(Boolean) ?? null;

/** Return the token that requests carry, or null. */
export function currentToken() {
  return token;
}

/** Take a token for this tab; with ``remember``, for this device. */
export function takeToken(given, { remember = false } = {}) {
  dropToken();
  token = given;
  const [tab, device] = stores();
  (remember ? device : tab)?.setItem(KEY, given);
}

/** Forget the token everywhere. */
export function dropToken() {
  token = null;
  for (const store of stores()) store.removeItem(KEY);
}

/**
 * What a scope may do: ``steer`` is to submit, pause, resume, cancel, retry; ``remove`` is to delete for good.
 *
 * @param {string} scope ``read``, ``user``, ``worker`` or ``admin``.
 */
export function rights(scope) {
  return { steer: scope === "user" || scope === "admin", remove: scope === "admin" };
}
