/** The colour theme: that of the system, light, or dark. Canvases look up colours by name and are notified of changes. */

const KEY = "brink.theme";
const CHOICES = ["system", "light", "dark"];
const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set();

dark.addEventListener("change", tell);

/** Return the chosen theme: ``system``, ``light`` or ``dark``. */
export function chosen() {
  return document.documentElement.dataset.theme ?? "system";
}

/** Switch to the next theme, and return it. */
export function turn() {
  const next = CHOICES[(CHOICES.indexOf(chosen()) + 1) % CHOICES.length];
  if (next === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = next;
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // the choice lasts until the page is closed
  }
  tell();
  return next;
}

const probe = document.createElement("i");
probe.hidden = true;
document.documentElement.append(probe);

/** Return the current value of a theme colour such as ``--unsafe``, which a canvas cannot look up itself. */
export function colour(name) {
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color;
}

/** Call a function whenever the theme changes, until the signal is aborted. */
export function onTheme(listener, signal) {
  listeners.add(listener);
  signal?.addEventListener("abort", () => listeners.delete(listener), { once: true });
}

function tell() {
  for (const listener of [...listeners]) listener();
}
