// Notifications of the desktop when a person is needed: a fault, an interrupted, held or finished run, a port that has vanished. Only
// pages from this computer or over HTTPS may show them, and only if the person allows it.
import {byId} from '/text.js';
import {translated} from '/said.js';
import {t} from '/language.js';

const TEXT = {
  insecure: t('Browsers show notifications only for pages over HTTPS or from this computer (localhost).'), missing: t('This browser shows no notifications.'),
  denied: t('Notifications of this page are blocked in the browser.'), off: t('Off. It tells of a fault, of an interrupted, held or finished run, and of a port that has vanished.'),
  on: t('On, as long as this page is open.'), enable: t('Notify me here'), disable: t('Do not notify me'),
  held: t('The run is held; the stage stands still.'), port: t('A port has vanished; the run waits for it.'), complete: t('The run is complete.'), interrupted: t('The run is interrupted and can be resumed.'), fault: t('A fault has ended the activity.'),
};

export class Notifier {
  constructor() {
    this.on = false;
    this.possible = isSecureContext && 'Notification' in globalThis;
    byId('notify').disabled = !this.possible;
    byId('notify').addEventListener('click', () => this.toggle());
    this.show();
  }

  async toggle() {
    this.on = !this.on && (await Notification.requestPermission()) === 'granted';
    this.show();
  }

  show() {
    byId('notify').textContent = this.on ? TEXT.disable : TEXT.enable;
    byId('notify-words').textContent = !isSecureContext ? TEXT.insecure : !this.possible ? TEXT.missing : this.on ? TEXT.on : Notification.permission === 'denied' ? TEXT.denied : TEXT.off;
  }

  receive(message) {
    if (!this.on) return;
    const say = (words, more) => new Notification(byId('bench-name').textContent || 'abcal', {body: [words, more && (translated(more) ?? more)].filter(Boolean).join(' '), tag: 'abcal'});
    if (message.type === 'fault') say(TEXT.fault, message.words);
    if (message.type === 'finished') say(message.complete ? TEXT.complete : TEXT.interrupted, message.reason);
    if (message.type !== 'phase' || message.phase === this.phase) return;
    this.phase = message.phase;
    if (message.phase === 'held') say(TEXT.held);
    if (message.phase === 'waiting for a port to come back') say(TEXT.port);
  }
}
