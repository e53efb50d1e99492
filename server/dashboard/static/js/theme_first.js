// Before the first paint: the theme that was chosen here. A classic script, since modules run too late for that.
"use strict";
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("brink.theme");
  } catch {
    // no storage: the system's theme
  }
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
})();
