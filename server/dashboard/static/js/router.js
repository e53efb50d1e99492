/** Navigation: the current place is the part of the address after the #. */

/**
 * @typedef {object} Place
 * @property {string[]} parts Parts of the path, decoded: ``["campaigns", "3f2a"]``.
 * @property {URLSearchParams} query
 */

/** Return the place that the address names. */
export function place(hash = location.hash) {
  const [path, query = ""] = hash.replace(/^#\/?/, "").split("?");
  return { parts: path.split("/").filter(Boolean).map(decode), query: new URLSearchParams(query) };
}

function decode(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** Return a link to a place: ``link("campaigns", id)``, with an object as the last part for the query. */
export function link(...parts) {
  const last = parts.at(-1);
  const query = last !== null && typeof last === "object" ? parts.pop() : {};
  const search = new URLSearchParams(Object.entries(query).filter(([, value]) => value !== null && value !== undefined));
  const path = `#/${parts.map((part) => encodeURIComponent(part)).join("/")}`;
  return String(search) ? `${path}?${search}` : path;
}

/** Navigate to a place. */
export function go(...parts) {
  location.hash = link(...parts);
}

/** Change the query of the current place without adding to the history. */
export function rewrite(changes) {
  const { parts, query } = place();
  for (const [name, value] of Object.entries(changes)) {
    if (value === null || value === undefined || value === "") query.delete(name);
    else query.set(name, value);
  }
  history.replaceState(null, "", link(...parts, Object.fromEntries(query)));
}
