// Applies the chosen theme before the first paint. A classic script, because modules run too late.
"use strict";
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("brink.theme");
  } catch {
    // no storage: use the system's theme
  }
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
})();
