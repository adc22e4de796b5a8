// Operator overrides of the selected vehicle, in two steps: an override decides what an aircraft follows.

import { byId, el, setText } from "./dom.js";
import { post } from "./confirm.js";

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
  constructor(confirmation) {
    this.confirmation = confirmation;
    this.sysid = null;
    this.buttons = new Map(Object.entries(OVERRIDES).map(([key, [text]]) => {
      const button = el("button", { type: "button", value: key, onclick: () => this.arm(key) }, text);
      byId(`${key.split(" ")[0]}-overrides`).append(button);
      return [key, button];
    }));
  }

  allow(allowed) {
    byId("commands").hidden = !allowed;
  }

  select(sysid) {
    this.sysid = sysid;
    this.confirmation.disarm();
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
    const [text, effect] = OVERRIDES[key];
    if (byId("token").value === "") {
      setText(byId("command-result"), "Enter the operator's token first: nothing was sent.");
      byId("token").focus();
      return;
    }
    setText(byId("command-result"), "");
    const sysid = this.sysid;
    const title = `Vehicle ${sysid}: ${text}?`;
    this.confirmation.arm({ button: this.buttons.get(key), text, title, effect, act: () => this.send(sysid, key) });
  }

  async send(sysid, key) {
    const [what, override] = key.split(" ");
    setText(byId("command-result"), await post(`/api/vehicles/${sysid}/${what}`, { override }, `vehicle ${sysid}: done`));
    byId("command-result").scrollIntoView({ block: "nearest" });
  }
}
