// The activities of a bench in addition to runs: check without motion, levelling, and probing of the ports.
import {byId, element, table, DASH} from '/text.js';
import {said} from '/said.js';
import {t} from '/language.js';

// The texts without values.
const TEXT = {
  check: t('Check without motion'), level: t('Level'), probe: t('Ask the ports'),
  levelTitle: t('Level the stage?'), levelText: t('The Z axis makes a whole turn with X at zero, then both axes go to four positions. The tilt of Z and the zero of X are stored in the run folder.'), levelYes: t('Level, and turn the stage'),
  probeTitle: t('Ask every free port who answers?'), probeText: t('Nothing moves and no setting is stored. Instruments that send by themselves may be stopped until they are opened again.'), probeYes: t('Ask the ports'),
  levelled: t('The last levelling'), notLevelled: t('Not levelled from this console yet.'),
  ports: t('Ports of this computer'), heading: [t('Port'), t('Who answers'), t('As a bench file names it'), t('Description'), t('State')], noPorts: t('There are no serial ports.'), notAsked: t('Not asked yet.'),
  free: t('free'), notPermitted: t('not permitted for the user of the console'), jog: t('Jogging is on the view Live.'),
};

export class BenchView {
  constructor({ask, confirmed, clear}) {
    const button = (id, words, act) => {
      const made = element('button', {type: 'button', id}, words);
      made.addEventListener('click', act);
      return made;
    };
    this.buttons = [
      button('bench-check', TEXT.check, () => ask(TEXT.check, {do: 'check'}, {moves: false})),
      button('bench-level', TEXT.level, async () => {
        if (await confirmed(TEXT.levelTitle, `${TEXT.levelText} ${clear}`, TEXT.levelYes)) await ask(TEXT.level, {do: 'level', confirmed: true});
      }),
      button('bench-probe', TEXT.probe, async () => {
        if (await confirmed(TEXT.probeTitle, TEXT.probeText, TEXT.probeYes)) await ask(TEXT.probe, {do: 'probe'}, {moves: false});
      })];
    this.levelling = element('div', {id: 'levelling', role: 'status'}, TEXT.notLevelled);
    this.ports = element('div', {id: 'ports', class: 'stack', role: 'status'}, TEXT.notAsked);
    const card = (title, content) => element('section', {class: 'card block'}, element('h3', {}, title), content);
    byId('bench-body').replaceChildren(element('div', {class: 'bar'}, ...this.buttons), element('p', {}, TEXT.jog), card(TEXT.levelled, this.levelling), card(TEXT.ports, this.ports));
  }

  receive(message) {
    if (message.type === 'snapshot') {
      if (message.levelling) this.showLevelling(message.levelling);
      if (message.ports) this.showPorts(message.ports);
    }
    if (message.type === 'levelling') this.showLevelling(message);
    if (message.type === 'ports') this.showPorts(message);
  }

  offer(may, idle) {
    for (const button of this.buttons) button.disabled = !may || !idle;
  }

  showLevelling({file, lines}) {
    this.levelling.replaceChildren(element('ul', {}, ...lines.map((line) => element('li', {}, said(line)))),
      element('p', {}, t`Stored in ${file}. In the bench file this gives it to the joint estimator: `, element('code', {}, '[stage]'), ' ', element('code', {}, `level_file = "${file}"`)));
  }

  showPorts({ports}) {
    if (!ports.length) return this.ports.replaceChildren(TEXT.noPorts);
    const state = (port) => (port.holder ? t`in use by ${port.holder}` : port.permitted ? TEXT.free : TEXT.notPermitted);
    this.ports.replaceChildren(table(TEXT.ports, TEXT.heading, ports.map((port) => [port.path, port.found ? said(port.found) : DASH, port.usb ? `port = "${port.usb}"` : '', port.description || DASH, state(port)])));
  }
}
