/** How campaigns and experiments stand. */

const OPEN = new Set(["running", "paused"]);

/** In the order in which people ask for them. */
export const STATUSES = [...OPEN, "finished", "cancelled", "failed"];

/** Whether more may come; what has ended stays as it is. */
export function isOpen(status) {
  return OPEN.has(status);
}
