// The hot standby: which of two services sends, since when, when the other one gave its last sign of life, and the orders to both.

import { age, byId, el, setText } from "./dom.js";
import { post } from "./confirm.js";

const STATES = {
  listening: "listening whether the other service sends",
  active: "active: this service sends",
  held_up: "stopped for a moment: finding out whether the other service sends",
  standby: "standing by: follows, and takes over if the other service fails",
  passive: "passive: follows, and takes over only when told",
};
const SENDS = { this: "this service", other: "the other service", nobody: "NOBODY", unknown: "not known" };
const ORDERS = {
  take_over: ["Take over", "This service sends from now on. The other one stops sending first, where it is heard.", ["standby", "passive"]],
  release: ["Let the other one take over", "The other service sends from now on, and this one stands by.", ["active"]],
  stand_by: ["Stand by", "This service takes over by itself if the other one fails.", ["passive"]],
};

export class StandbyPanel {
  constructor(confirmation) {
    this.confirmation = confirmation;
    this.allowed = false;
    this.buttons = Object.entries(ORDERS).map(([order, [text, effect, states]]) => {
      const button = el("button", { type: "button", value: order, onclick: () => this.arm(button, order, text, effect) }, text);
      byId("standby-orders").append(button);
      return { button, states };
    });
  }

  allow(allowed) {
    this.allowed = allowed;
  }

  // `older`: how old the picture is, s, where no more arrive.
  show(standby, timeText, older) {
    byId("standby-panel").hidden = standby === null;
    if (standby === null) return;
    byId("standby-form").hidden = !this.allowed;
    byId("standby-panel").className = standby.problem === null ? "" : "troubled";
    setText(byId("standby-state"), `${STATES[standby.state]} (${standby.reason})`);
    setText(byId("standby-since"), timeText(standby.since_s));
    setText(byId("standby-sends"), SENDS[standby.sends]);
    const other = STATES[standby.other_state]?.replace("this service", "it").replace("the other service", "this one") ?? "not heard";
    setText(byId("standby-other"), standby.other === null ? "never heard" : `${standby.other}: ${other}`);
    setText(byId("standby-heard"), standby.other_age_s === null ? "never" : `${age(standby.other_age_s + older)} ago`);
    setText(byId("standby-problem"), standby.problem ?? "");
    for (const { button, states } of this.buttons) button.hidden = !states.includes(standby.state) && this.confirmation.armed?.button !== button;
  }

  arm(button, order, text, effect) {
    if (byId("standby-token").value === "") {
      setText(byId("standby-result"), "Enter the operator's token first: nothing was sent.");
      byId("standby-token").focus();
      return;
    }
    setText(byId("standby-result"), "");
    this.confirmation.arm({ button, text, title: `Hot standby: ${text}?`, effect, act: async () => {
      setText(byId("standby-result"), await post("/api/standby", { order }, "done"));
    } });
  }
}
