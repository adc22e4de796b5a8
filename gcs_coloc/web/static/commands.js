// The operator's commands on the selected vehicle. A press arms a button and says what it does, a second one within ten seconds
// sends: the word decides what an aircraft follows.

import { byId, el, setText } from "./dom.js";

const ARMED_S = 10;
// Key: what is commanded and the word, as the service takes them. Value: the button, and what it does.
const WORDS = {
  "gps failed": ["Declare GPS failed", "It is located from its ranges and sent that position; its own is not believed."],
  "gps healthy": ["Declare GPS healthy", "Its own position is believed, whatever the evidence says."],
  "gps auto": ["Decide by evidence", "Whether its GPS works is judged by what it sends."],
  "aid on": ["Aid it whatever its GPS", "It is sent the position from its ranges; its own is not believed meanwhile."],
  "aid off": ["Never aid it", "Nothing is sent to it, even without GPS."],
  "aid auto": ["Aid it as its GPS needs", "It is sent its position only while its GPS has failed."],
  "primary ours": ["Set GPS_PRIMARY to our receiver", "Writes a parameter of its autopilot, once it is aided and seen to take our fix: it then flies by that, whatever its own receiver says. Restored by the next button, when its aid ends, and when the service stops."],
  "primary own": ["Restore GPS_PRIMARY", "Writes back the value that was there before: its autopilot follows its own receiver again, even if that lies."],
  "primary auto": ["GPS_PRIMARY as configured", "Set and restored by the switch_primary setting of the service."],
};

export class Commands {
  constructor() {
    this.sysid = null;
    for (const [value, [text]] of Object.entries(WORDS)) {
      byId(`${value.split(" ")[0]}-words`).append(el("button", { type: "submit", value }, text));
    }
    byId("commands").addEventListener("submit", (event) => {
      event.preventDefault();
      this.press(event.submitter);
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

  press(button) {
    if (this.armed === button) {
      this.disarm();
      this.send(...button.value.split(" "));
      return;
    }
    this.disarm();
    this.armed = button;
    const [text, effect] = WORDS[button.value];
    setText(button, `${text}: press again to confirm`);
    const told = byId("command-result");
    setText(told, `Vehicle ${this.sysid}: ${effect}`);
    button.closest("fieldset").append(told);
    told.scrollIntoView({ block: "nearest" });
    this.disarming = setTimeout(() => {
      this.disarm();
      setText(byId("command-result"), "");
    }, ARMED_S * 1000);
  }

  async send(what, word) {
    const sysid = this.sysid;
    let text;
    try {
      const answer = await fetch(`/api/vehicles/${sysid}/${what}`, {
        method: "POST", headers: { Authorization: `Bearer ${byId("token").value}`, "Content-Type": "application/json" }, body: JSON.stringify({ word }),
      });
      text = answer.ok ? `vehicle ${sysid}: done` : `refused: ${(await answer.text()).trim()}`;
    } catch {
      text = "the service did not answer: nothing is known to have changed";
    }
    setText(byId("command-result"), text);
  }

  disarm() {
    clearTimeout(this.disarming);
    if (this.armed) setText(this.armed, WORDS[this.armed.value][0]);
    this.armed = null;
  }
}
