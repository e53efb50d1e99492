/** Waiting, and not going on while nobody looks. */

/** Resolve once the page is seen: at once, if it is; never, if the signal ends it before. */
export async function seen(signal) {
  while (document.hidden) {
    await new Promise((resolve) => document.addEventListener("visibilitychange", resolve, { once: true, signal }));
  }
}

/** Resolve after a while. */
export function pause(ms) {
  return new Promise((resolve) => setTimeout(resolve, ms));
}
