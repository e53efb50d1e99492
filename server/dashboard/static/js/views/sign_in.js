/** The sign-in form. */

import { ApiError, dropToken, get, takeToken } from "../api.js";
import { h, replace, text } from "../dom.js";

const REASONS = {
  401: "Token rejected: it is misspelt, revoked or expired.",
  403: "This is a worker token, which can only lease jobs. Use a token of scope read, user or admin.",
};

/**
 * @param {Element} main
 * @param {{reason: string, signal: AbortSignal, done: () => void}} given Why a token is needed, and what to call afterwards.
 */
export function show(main, { reason, signal, done }) {
  document.title = "Sign in · Brink";
  const trouble = h("p.trouble", { role: "alert", id: "token-trouble" }, reason);
  const token = h("input", {
    id: "token", type: "password", autocomplete: "current-password", spellcheck: "false", required: true,
    "aria-describedby": "token-trouble token-help",
  });
  const remember = h("input", { id: "remember", type: "checkbox" });
  const go = h("button.primary", { type: "submit" }, "Sign in");

  async function enter(event) {
    event.preventDefault();
    go.disabled = true;
    takeToken(token.value.trim(), { remember: remember.checked });
    try {
      await get("access", { signal });
      done();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      dropToken();
      text(trouble, REASONS[error.status] ?? error.message);
      token.select();
    } finally {
      go.disabled = false;
    }
  }

  replace(main, h("form.sign-in.card", { onsubmit: enter },
    h("h1", null, "Sign in"),
    h("p", { id: "token-help" }, "This coordinator requires a token. Its administrator can create one with ",
      h("code", null, "brink token create --scope user NAME"), "."),
    h("label", { for: "token" }, "Token"), token,
    h("label.check", null, remember, " Remember it on this device"),
    trouble, go));
  token.focus();
}
