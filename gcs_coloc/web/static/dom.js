// Helpers that build elements; text is inserted as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

export const byId = (id) => document.getElementById(id);

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
}

export const el = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);
export const svg = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

// Changes the text only where it differs, so that a screen reader does not repeat it five times a second.
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// No line break at an arrow.
export const prose = (text) => text.replaceAll(" -> ", "\u00a0\u2192\u00a0");

export const metres = (value, digits = 1) => (value === null ? "-" : `${value.toFixed(digits)} m`);
export const milliseconds = (seconds) => (seconds === null ? "-" : `${(seconds * 1e3).toFixed(seconds < 0.01 ? 1 : 0)} ms`);
export const number = (value, digits = 1) => (value === null ? "-" : value.toFixed(digits));
export const age = (seconds) => (seconds < 60 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`);
