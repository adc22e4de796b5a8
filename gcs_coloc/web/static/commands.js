// Operator overrides of the selected vehicle. The first press says what a button does, a second within ten seconds sends it:
// an override decides what an aircraft follows.

import { byId, el, setText } from "./dom.js";

const ARMED_S = 10;
// Key: the command's path and its override, as the service names them. Value: the button, and what it does.
const OVERRIDES = {
  "gps failed": ["Declare GPS failed", "It is located from its ranges and sent that position; its reported position is not trusted."],
  "gps healthy": ["Declare GPS healthy", "Its reported position is trusted, whatever the evidence says."],
  "gps auto": ["Decide by evidence", "The service decides by the evidence whether its GPS works."],
  "aiding on": ["Aiding on", "It is sent the position from its ranges whatever its GPS says; its reported position is not trusted meanwhile."],
  "aiding off": ["Aiding off", "Nothing is sent to it, even when its GPS is lost."],
  "aiding auto": ["Aiding automatic", "It is sent its position only while its GPS has failed."],
  "gps_primary ours": ["Set GPS_PRIMARY to our receiver", "Writes a parameter of its autopilot, once it is aided and acknowledges our fix: it then flies by that, whatever its own receiver says. Restored by the next button, when its aiding ends, and when the service stops."],
  "gps_primary own": ["Restore GPS_PRIMARY", "Writes back the value from before: its autopilot follows its own receiver again, even if that is faulty."],
  "gps_primary auto": ["GPS_PRIMARY as configured", "Set and restored by the switch_primary setting of the service."],
};

export class Commands {
  constructor() {
    this.sysid = null;
    for (const [value, [text]] of Object.entries(OVERRIDES)) {
      byId(`${value.split(" ")[0]}-overrides`).append(el("button", { type: "submit", value }, text));
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
    const [text, effect] = OVERRIDES[button.value];
    setText(button, `${text}: press again to confirm`);
    const result = byId("command-result");
    setText(result, `Vehicle ${this.sysid}: ${effect}`);
    button.closest("fieldset").append(result);
    result.scrollIntoView({ block: "nearest" });
    this.disarming = setTimeout(() => {
      this.disarm();
      setText(byId("command-result"), "");
    }, ARMED_S * 1000);
  }

  async send(what, override) {
    const sysid = this.sysid;
    let text;
    try {
      const answer = await fetch(`/api/vehicles/${sysid}/${what}`, {
        method: "POST", headers: { Authorization: `Bearer ${byId("token").value}`, "Content-Type": "application/json" }, body: JSON.stringify({ override }),
      });
      text = answer.ok ? `vehicle ${sysid}: done` : `refused: ${(await answer.text()).trim()}`;
    } catch {
      text = "the service did not answer: nothing is known to have changed";
    }
    setText(byId("command-result"), text);
  }

  disarm() {
    clearTimeout(this.disarming);
    if (this.armed) setText(this.armed, OVERRIDES[this.armed.value][0]);
    this.armed = null;
  }
}
