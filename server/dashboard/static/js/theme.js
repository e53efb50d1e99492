/** Light or dark: the system's, or what was chosen here. Canvases ask for colours by name and are told of changes. */

const KEY = "brink.theme";
const CHOICES = ["system", "light", "dark"];
const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set();

dark.addEventListener("change", tell);

/** Return what was chosen: ``system``, ``light`` or ``dark``. */
export function chosen() {
  return document.documentElement.dataset.theme ?? "system";
}

/** Choose the next of the three. */
export function turn() {
  const next = CHOICES[(CHOICES.indexOf(chosen()) + 1) % CHOICES.length];
  if (next === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = next;
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // it holds until the page is left
  }
  tell();
  return next;
}

const probe = document.createElement("i");
probe.hidden = true;
document.documentElement.append(probe);

/** Return a colour of the theme, such as ``--unsafe``, as it is now: a canvas knows no names. */
export function colour(name) {
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color;
}

/** Call a function whenever colours change, until the signal says stop. */
export function onTheme(listener, signal) {
  listeners.add(listener);
  signal?.addEventListener("abort", () => listeners.delete(listener), { once: true });
}

function tell() {
  for (const listener of [...listeners]) listener();
}
