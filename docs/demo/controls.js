// The visitor's hands: keyboard, touch buttons and gamepad, as an action of the policy's kind.

const KEYS = {
  ArrowLeft: "left", KeyA: "left",
  ArrowRight: "right", KeyD: "right",
  ArrowUp: "forwards", KeyW: "forwards",
  ArrowDown: "backwards", KeyS: "backwards",
  Space: "brake",
};
const COAST = 0.15; // pedal against the motion with nothing pressed
const DEAD = 0.1; // of a stick

export class Controls {
  // `commands` are functions by key code, and `drive` of keys that drive; `buttons` have the attribute data-hold.
  constructor(commands, buttons) {
    this.held = new Set();
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
      if (event.code in KEYS) {
        this.held.add(KEYS[event.code]);
        commands.drive();
        event.preventDefault();
      } else if (!event.repeat) commands[event.code]?.();
    });
    addEventListener("keyup", (event) => this.held.delete(KEYS[event.code]));
    addEventListener("blur", () => this.held.clear());
    for (const button of buttons) {
      const hold = button.dataset.hold;
      button.addEventListener("pointerdown", (event) => {
        button.setPointerCapture(event.pointerId);
        this.held.add(hold);
      });
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
        button.addEventListener(end, () => this.held.delete(hold));
      }
      button.addEventListener("contextmenu", (event) => event.preventDefault());
    }
  }

  // Steer and pedal in [-1, 1] at a speed [m/s], and whether the visitor does anything.
  read(speed) {
    const has = (name) => Number(this.held.has(name));
    let steer = has("left") - has("right");
    let pedal = has("forwards") - has("backwards");
    let brake = has("brake");
    const pad = navigator.getGamepads?.().find((x) => x?.connected);
    if (pad) {
      const stick = -pad.axes[0];
      if (Math.abs(stick) > DEAD) steer = stick;
      const trigger = (pad.buttons[7]?.value ?? 0) - (pad.buttons[6]?.value ?? 0);
      if (Math.abs(trigger) > DEAD) pedal = trigger;
      brake ||= Number(pad.buttons[0]?.pressed ?? 0);
    }
    const active = Boolean(steer || pedal || brake);
    if (brake) pedal = -Math.sign(speed) * Number(Math.abs(speed) > 0.1);
    else if (!pedal && Math.abs(speed) > 0.3) pedal = -COAST * Math.sign(speed);
    return { action: [steer, pedal], active };
  }
}
