// Operator overrides of the selected vehicle. A press arms one and says what it does; only a second act elsewhere sends it:
// an override decides what an aircraft follows.

import { byId, el, setText } from "./dom.js";

const CONFIRM_AFTER_MS = 1000; // longer than a double click, and than a press that slips
const ARMED_MS = 30000;
const TOKEN = "operator's token";
// Key: the command's path and its override, as the service names them. Value: the button, what it does, and what holds then.
const OVERRIDES = {
  "gps failed": ["Declare GPS failed", "It is located from its ranges and sent that position; its reported position is not trusted.", "declared failed"],
  "gps healthy": ["Declare GPS healthy", "Its reported position is trusted, whatever the evidence says.", "declared healthy"],
  "gps auto": ["Decide by evidence", "The service decides by the evidence whether its GPS works.", "decided by evidence"],
  "aiding on": ["Aiding on", "It is sent the position from its ranges whatever its GPS says; its reported position is not trusted meanwhile.", "on"],
  "aiding off": ["Aiding off", "Nothing is sent to it, even when its GPS is lost.", "off"],
  "aiding auto": ["Aiding automatic", "It is sent its position only while its GPS has failed.", "automatic"],
  "gps_primary ours": ["Set GPS_PRIMARY to our receiver", "Writes a parameter of its autopilot, once it is aided and acknowledges our fix: it then flies by that, whatever its own receiver says. Restored by the next button, when its aiding ends, and when the service stops.", "our receiver"],
  "gps_primary own": ["Restore GPS_PRIMARY", "Writes back the value from before: its autopilot follows its own receiver again, even if that is faulty.", "its own receiver"],
  "gps_primary auto": ["GPS_PRIMARY as configured", "Set and restored by the switch_primary setting of the service.", "as configured"],
};
// The fields of a vehicle's snapshot by the command's path.
const IN_FORCE = { gps: "gps_override", aiding: "aiding_override", gps_primary: "primary_override" };

export class Commands {
  constructor() {
    this.sysid = null;
    this.armed = null;
    this.buttons = new Map(Object.entries(OVERRIDES).map(([key, [text]]) => {
      const button = el("button", { type: "button", value: key, onclick: () => this.arm(key) }, text);
      byId(`${key.split(" ")[0]}-overrides`).append(button);
      return [key, button];
    }));
    // Enter in the token field commands nothing.
    byId("commands").addEventListener("submit", (event) => event.preventDefault());
    byId("token").value = sessionStorage.getItem(TOKEN) ?? "";
    byId("cancel-command").addEventListener("click", () => this.disarm());
    byId("send-command").addEventListener("click", () => this.send());
    byId("confirm").addEventListener("keydown", ({ key }) => {
      if (key === "Escape") this.disarm();
    });
  }

  allow(allowed) {
    byId("commands").hidden = !allowed;
  }

  select(sysid) {
    this.sysid = sysid;
    this.disarm();
    setText(byId("command-result"), "");
  }

  // Marks the overrides in force, and says who gave them.
  show(vehicles) {
    const snapshot = vehicles.find((one) => one.snapshot.sysid === this.sysid)?.snapshot;
    if (snapshot === undefined) return;
    for (const [what, field] of Object.entries(IN_FORCE)) {
      const by = snapshot[`${field}_by`];
      setText(byId(`${what}-in-force`), OVERRIDES[`${what} ${snapshot[field]}`][2] + (by === null ? "" : ` (by ${by})`));
    }
    for (const [key, button] of this.buttons) {
      const [what, override] = key.split(" ");
      button.setAttribute("aria-pressed", String(snapshot[IN_FORCE[what]] === override));
    }
  }

  arm(key) {
    if (this.armed === key) return;
    this.disarm();
    const [text, effect] = OVERRIDES[key];
    const button = this.buttons.get(key);
    if (byId("token").value === "") {
      setText(byId("command-result"), "Enter the operator's token first: nothing was sent.");
      byId("token").focus();
      return;
    }
    this.armed = key;
    setText(byId("command-result"), "");
    setText(button, `${text}: not sent yet, confirm it`);
    button.classList.add("armed");
    setText(byId("confirm-title"), `Vehicle ${this.sysid}: ${text}?`);
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

  async send() {
    const [sysid, token] = [this.sysid, byId("token").value];
    const [what, override] = this.armed.split(" ");
    this.disarm();
    let text;
    try {
      const answer = await fetch(`/api/vehicles/${sysid}/${what}`, {
        method: "POST", headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/json" }, body: JSON.stringify({ override }),
      });
      if (answer.ok) sessionStorage.setItem(TOKEN, token);
      else if (answer.status === 403) sessionStorage.removeItem(TOKEN);
      text = answer.ok ? `vehicle ${sysid}: done` : `refused: ${(await answer.text()).trim()}`;
    } catch {
      text = "the service did not answer: nothing is known to have changed";
    }
    setText(byId("command-result"), text);
    byId("command-result").scrollIntoView({ block: "nearest" });
  }

  disarm() {
    this.timers?.forEach(clearTimeout);
    byId("send-command").disabled = true;
    if (this.armed === null) return;
    const button = this.buttons.get(this.armed);
    const hadFocus = byId("confirm").contains(document.activeElement);
    setText(button, OVERRIDES[this.armed][0]);
    button.classList.remove("armed");
    byId("confirm").hidden = true;
    this.armed = null;
    if (hadFocus) button.focus({ preventScroll: true });
  }
}
