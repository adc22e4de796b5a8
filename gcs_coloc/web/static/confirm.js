// The two steps of a command: a press arms a button and says what it does; only a second act elsewhere sends it.

import { byId, setText } from "./dom.js";

const CONFIRM_AFTER_MS = 1000; // longer than a double click, and than a press that slips
const ARMED_MS = 30000;

export class Confirmation {
  constructor() {
    this.armed = null;
    byId("cancel-command").addEventListener("click", () => this.disarm());
    byId("send-command").addEventListener("click", () => {
      const { act } = this.armed;
      this.disarm();
      act();
    });
    byId("confirm").addEventListener("keydown", ({ key }) => {
      if (key === "Escape") this.disarm();
    });
  }

  // `text` is the button's, `title` what is asked, `effect` what it does, `act` what is done once it is confirmed.
  arm({ button, text, title, effect, act }) {
    if (this.armed?.button === button) return;
    this.disarm();
    this.armed = { button, text, act };
    setText(button, `${text}: not sent yet, confirm it`);
    button.classList.add("armed");
    setText(byId("confirm-title"), title);
    setText(byId("confirm-effect"), effect);
    setText(byId("send-command"), `Send: ${text}`);
    const { top, bottom } = button.getBoundingClientRect();
    const isLow = top + bottom > window.innerHeight;
    byId("confirm").className = isLow ? "high" : "low"; // never under the pointer that armed it
    byId("confirm").hidden = false;
    byId("cancel-command").focus({ preventScroll: true });
    this.timers = [
      setTimeout(() => { byId("send-command").disabled = false; }, CONFIRM_AFTER_MS),
      setTimeout(() => this.disarm(), ARMED_MS),
    ];
  }

  disarm() {
    this.timers?.forEach(clearTimeout);
    byId("send-command").disabled = true;
    if (this.armed === null) return;
    const { button, text } = this.armed;
    const hadFocus = byId("confirm").contains(document.activeElement);
    setText(button, text);
    button.classList.remove("armed");
    byId("confirm").hidden = true;
    this.armed = null;
    if (hadFocus) button.focus({ preventScroll: true });
  }
}

const TOKEN = "operator's token";
const fields = () => document.querySelectorAll("input.token");

// Every field for the token shows the same one.
export function shareToken() {
  for (const field of fields()) {
    field.value = sessionStorage.getItem(TOKEN) ?? "";
    field.addEventListener("input", () => fields().forEach((other) => { other.value = field.value; }));
    // Enter in the field commands nothing.
    field.form?.addEventListener("submit", (event) => event.preventDefault());
  }
}

// Posts a command with the token; returns what became of it, in words.
export async function post(path, content, done) {
  const token = fields()[0].value;
  try {
    const answer = await fetch(path, {
      method: "POST", headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/json" }, body: JSON.stringify(content),
    });
    if (answer.ok) sessionStorage.setItem(TOKEN, token);
    else if (answer.status === 403) sessionStorage.removeItem(TOKEN);
    return answer.ok ? done : `refused: ${(await answer.text()).trim()}`;
  } catch {
    return "the service did not answer: nothing is known to have changed";
  }
}
