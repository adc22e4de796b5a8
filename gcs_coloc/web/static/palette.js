// Colours that people with a colour vision deficiency can tell apart (Okabe and Ito); sign and dash say the same again.

export const SIGNS = { good: "✓", caution: "!", bad: "✕", unknown: "?" };
export const SEVERITY = { bad: 0, caution: 1, unknown: 2, good: 3 };
export const LIGHT_WORDS = { good: "good", caution: "caution", bad: "alarm", unknown: "unknown" };

// Whether a vehicle would be located if its GPS failed now: in words, and as a sign behind its name on the map.
export const READINESS_WORDS = { ready: "ready", degraded: "degraded", not_ready: "not ready", unknown: "unknown" };
export const READINESS_SIGNS = { ready: "●", degraded: "◐", not_ready: "○", unknown: "" };

const SERIES = ["#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#8c6d1f", "#7f7f7f"];
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];

export const seriesColour = (index) => SERIES[index % SERIES.length];
export const seriesDash = (index) => DASHES[Math.floor(index / SERIES.length + index) % DASHES.length];
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
