// The first three items of docs/examples/tray.toml with few angles, for tests: all is simulated.
import {readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';

export const examples = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/examples');
const example = readFileSync(path.join(examples, 'tray.toml'), 'utf8');
export const tray = example.slice(0, example.lastIndexOf('[[item]]', example.indexOf('# item 4')))
  .replace('bench with a tray', 'Bench 5').replace('steps = 24\nstep_deg = 15.0', 'steps = 12\nstep_deg = 30.0').replace('dwell_readings = 300', 'dwell_readings = 50');

// Its instruments as `abcal emulate` serves them in the folder `links`, and quick: for tests in real time.
export const LINKS = ['stage', 'item-1', 'item-2', 'item-3'];
export const emulatedTray = LINKS.reduce((text, name) => text.replace('port = "simulated"', `port = "links/${name}"`), tray)
  .replace('settle_s = 2.0', 'settle_s = 0.3').replace('dwell_readings = 50', 'dwell_readings = 20')
  .replaceAll('speed_deg_per_s = 40.0\nacceleration_deg_per_s2 = 200.0', 'speed_deg_per_s = 200.0\nacceleration_deg_per_s2 = 5000.0');
