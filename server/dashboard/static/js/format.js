/** Numbers, times and words for display. */

const whole = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });
const day = new Intl.DateTimeFormat("en-GB", { dateStyle: "medium", timeStyle: "short" });

/** ``12,345``; a dash if unknown. */
export function count(value) {
  return value === null || value === undefined ? "–" : whole.format(value);
}

/** The words with a capital first letter. */
export function capital(words) {
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** The words as a sentence. */
export function sentence(words) {
  return /[.!?]$/.test(words) ? capital(words) : `${capital(words)}.`;
}

/** The words without the full stop at their end, for a sentence that goes on. */
export function clause(words) {
  return words.replace(/\.$/, "");
}

/** A number with that many significant digits: ``0.0123``. */
export function figure(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 10 ** digits) return whole.format(value);
  return minus(String(Number(value.toPrecision(digits))));
}

/** A share as per cent: ``7%``, ``0.4%``. */
export function percent(share) {
  if (share === null || share === undefined || Number.isNaN(share)) return "–";
  const value = 100 * share;
  return `${value !== 0 && Math.abs(value) < 1 ? value.toFixed(1) : Math.round(value)}%`;
}

/** A span of time: ``42 s``, ``3 min 05 s``, ``2 h 10 min``, ``3 d 4 h``. */
export function span(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  const s = Math.max(0, Math.round(seconds));
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, "0")} s`;
  if (s < 86_400) return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, "0")} min`;
  return `${Math.floor(s / 86_400)} d ${Math.floor((s % 86_400) / 3600)} h`;
}

/** A rate: ``5.2 per second``, ``12 per minute``, ``3 per hour``. */
export function rate(perSecond) {
  if (perSecond === null || perSecond === undefined) return "–";
  if (perSecond >= 1) return `${figure(perSecond, 2)} per second`;
  if (perSecond * 60 >= 1) return `${figure(perSecond * 60, 2)} per minute`;
  return `${figure(perSecond * 3600, 2)} per hour`;
}

/** A local date and time: ``22 Nov 2026, 10:16``. */
export function when(iso) {
  return iso ? day.format(new Date(iso)) : "–";
}

/** How long ago by the coordinator's clock: ``3 s ago``. */
export function ago(iso, nowMs) {
  return iso ? `${span((nowMs - Date.parse(iso)) / 1000)} ago` : "–";
}

/** ``1 solution``, ``2 solutions``. */
export function plural(number, one, many = `${one}s`) {
  return `${count(number)} ${number === 1 ? one : many}`;
}

/** ``front_gap`` as ``front gap``. */
export function spaced(name) {
  return String(name).replaceAll("_", " ");
}

/** Return the rows with ``alike``: the id where another row has the same name, otherwise empty. */
export function toldApart(rows) {
  const names = new Map();
  for (const { name } of rows) names.set(name, (names.get(name) ?? 0) + 1);
  return rows.map((row) => ({ ...row, alike: names.get(row.name) > 1 ? row.id : "" }));
}

/** An id without its version: ``mlcshe`` for ``mlcshe@1``. */
export function plainId(id) {
  return String(id).split("@")[0];
}

/** A true minus sign. */
export function minus(written) {
  return written.replace("-", "−");
}

/** The value of a parameter. */
export function value(given) {
  if (typeof given === "number") return figure(given, 4);
  if (given === null || given === undefined) return "–";
  return spaced(given);
}
