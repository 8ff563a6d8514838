// Turns one axis by hand: by an angle or to an angle, after a confirmation, or as long as a button is held.
import {byId} from '/text.js';
import {tell} from '/stop.js';
import {t} from '/language.js';

const SIGN_EACH_MS = 100;  // The bench halts the axis if it receives none for 300 ms.

export class JogForm {
  constructor({ask, confirmed, clear}) {
    this.ask = ask;
    byId('jog-form').addEventListener('submit', async (event) => {
      event.preventDefault();
      const axis = byId('jog-axis').value, angle = Number(byId('jog-by').value), isTo = byId('jog-how').value === 'to';
      const title = isTo ? t`Turn axis ${axis.toUpperCase()} to ${angle} degrees?` : t`Turn axis ${axis.toUpperCase()} by ${angle} degrees?`;
      if (await confirmed(title, t`It is homed first if it is not homed. ${clear}`, t('Turn the stage')))
        await ask(t('Jog'), {do: 'jog', axis, [isTo ? 'to_deg' : 'by_deg']: angle, confirmed: true});
    });
    for (const direction of ['up', 'down']) this.offerHold(byId(`jog-${direction}`), direction);
    for (const [where, event] of [[window, 'blur'], [window, 'pagehide'], [document, 'visibilitychange']]) where.addEventListener(event, () => this.letGo());
  }

  offerHold(button, direction) {
    button.addEventListener('pointerdown', (event) => {
      if (event.button !== 0 || button.disabled) return;
      button.setPointerCapture(event.pointerId);
      this.hold(direction);
    });
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture', 'contextmenu', 'blur']) button.addEventListener(end, () => this.letGo());
    button.addEventListener('contextmenu', (event) => event.preventDefault());  // A long touch opens one.
    button.addEventListener('keydown', (event) => {
      if (![' ', 'Enter'].includes(event.key)) return;
      event.preventDefault();
      if (!event.repeat && !button.disabled) this.hold(direction);
    });
    button.addEventListener('keyup', () => this.letGo());
  }

  async hold(direction) {
    if (this.signs) return;
    this.signs = setInterval(() => tell({do: 'keep_turning'}), SIGN_EACH_MS);
    if (!(await this.ask(t('Jog'), {do: 'jog', axis: byId('jog-axis').value, while_held: direction, confirmed: true}))) this.letGo();
  }

  letGo() {
    if (!this.signs) return;
    clearInterval(this.signs);
    this.signs = null;
    tell({do: 'keep_turning', let_go: true});
  }

  offer(steer, idle) {
    // A button that is held stays enabled: a disabled one receives no release.
    for (const id of ['jog-up', 'jog-down']) byId(id).disabled = !this.signs && !(steer && idle);
    if (!steer) this.letGo();
  }

  receive() {}
}
