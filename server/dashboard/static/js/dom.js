/** Creating and updating elements. Content is always text, never markup. */

/**
 * Return a new element.
 *
 * @param {string} tag Such as ``div`` or ``div.card.wide``.
 * @param {object} [props] Attributes; ``on…`` are listeners, ``data`` is a mapping; ``value``, ``checked`` and the like are
 *   set as properties; null and false are left out.
 * @param {...*} children Nodes, texts, numbers, lists of them; null, undefined and false are left out.
 */
export function h(tag, props, ...children) {
  const [name, ...classes] = tag.split(".");
  const node = name === "svg" || SVG.has(name) ? document.createElementNS(SVG_NS, name) : document.createElement(name);
  if (classes.length) node.setAttribute("class", classes.join(" "));
  for (const [key, value] of Object.entries(props ?? {})) set(node, key, value);
  append(node, children);
  return node;
}

const SVG_NS = "http://www.w3.org/2000/svg";
const SVG = new Set(["path", "line", "rect", "circle", "g", "polyline", "text"]);
const AS_PROPERTY = new Set(["value", "checked", "disabled", "selected", "indeterminate", "hidden", "textContent"]);

function set(node, key, value) {
  if (value === null || value === undefined || value === false) return;
  if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
  else if (key === "data") Object.assign(node.dataset, value);
  else if (key === "style") Object.entries(value).forEach(([name, to]) => node.style.setProperty(name, to));
  else if (AS_PROPERTY.has(key) && !(node instanceof SVGElement)) node[key] = value;
  else if (key === "class") node.setAttribute("class", [node.getAttribute("class"), value].filter(Boolean).join(" "));
  else node.setAttribute(key, value === true ? "" : String(value));
}

function append(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child instanceof Node ? child : String(child));
  }
}

/** Replace the children of a node. */
export function replace(node, ...children) {
  node.replaceChildren();
  append(node, children);
  return node;
}

/** Set the text of a node if it differs, so that screen readers do not repeat unchanged text. */
export function text(node, words) {
  const told = String(words ?? "");
  if (node.textContent !== told) node.textContent = told;
  return node;
}

/** Set or remove an attribute if it differs. */
export function attribute(node, name, value) {
  if (value === null || value === undefined || value === false) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, String(value));
}

/**
 * Show one node for each item, in order, and reuse existing nodes, so that focus and scroll position survive.
 *
 * @param {Element} container
 * @param {Array} items
 * @param {(item: *) => string} key
 * @param {(item: *) => Element} create Creates the node; its ``update`` method, if any, is called with later items.
 */
export function keyed(container, items, key, create) {
  const known = new Map([...container.children].map((node) => [node.dataset.key, node]));
  let at = container.firstElementChild;
  for (const item of items) {
    const name = String(key(item));
    let node = known.get(name);
    if (node) {
      known.delete(name);
      node.update?.(item);
    } else {
      node = create(item);
      node.dataset.key = name;
    }
    if (node === at) at = at.nextElementSibling;
    else container.insertBefore(node, at);
  }
  for (const gone of known.values()) gone.remove();
}
