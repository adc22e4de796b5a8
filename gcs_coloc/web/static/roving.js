// Roving tab index: many elements are one stop of the Tab key; the arrow keys, Home and End move among them.

const STEPS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };

export class Roving {
  // `parent` holds the elements, among others.
  constructor(parent) {
    this.elements = new Map();
    this.stop = null;
    parent.addEventListener("keydown", (event) => this.press(event));
    parent.addEventListener("focusin", ({ target }) => {
      if (this.elements.has(target)) this.setStop(target);
    });
  }

  // `place` is its rank among the others.
  add(element, place) {
    this.elements.set(element, place);
    element.tabIndex = -1;
    if (this.stop === null) this.setStop(element);
  }

  // A focus on it moves to its neighbour, not to the beginning of the page.
  remove(element) {
    const order = this.inOrder();
    const i = order.indexOf(element);
    this.elements.delete(element);
    if (this.stop !== element) return;
    const focused = document.activeElement === element;
    this.setStop(order[i - 1] ?? order[i + 1] ?? null);
    if (focused) this.stop?.focus();
  }

  setStop(element) {
    if (this.stop !== null) this.stop.tabIndex = -1;
    this.stop = element;
    if (element !== null) element.tabIndex = 0;
  }

  press(event) {
    const order = this.inOrder();
    const i = order.indexOf(event.target);
    if (i < 0 || event.altKey || event.ctrlKey || event.metaKey) return;
    const to = { Home: 0, End: order.length - 1 }[event.key] ?? (event.key in STEPS ? i + STEPS[event.key] : null);
    if (to === null) return;
    event.preventDefault();
    order[Math.min(Math.max(to, 0), order.length - 1)].focus();
  }

  inOrder() {
    return [...this.elements].sort(([, a], [, b]) => a - b).map(([element]) => element);
  }
}
