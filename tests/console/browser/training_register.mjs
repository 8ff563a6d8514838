// A training register with persons, for the console of a test.
import {chmodSync, writeFileSync} from 'node:fs';
import path from 'node:path';

export const PASSWORD = 'correct horse 7';

// An administrator who approves, an operator and a watcher. Returns a function that runs `abcal lab` with further words.
export function makeRegister(served) {
  const {folder} = served;
  process.env.XDG_STATE_HOME = path.join(folder, 'state');
  const password = path.join(folder, 'password');
  writeFileSync(password, `${PASSWORD}\n`);
  chmodSync(password, 0o600);
  process.env.ABCAL_REGISTER = path.join(folder, 'register.db');
  const lab = (...words) => served.abcal('lab', ...words);
  const withPassword = (...words) => lab(...words, '--password-file', password);
  withPassword('init', '--laboratory', 'Example laboratory', '--administrator', 'Admin N. N.', '--training');
  withPassword('login', 'Admin N. N.');
  withPassword('add', 'person', 'Operator N. N.', '--role', 'technician', '--may', 'measure');
  withPassword('add', 'person', 'Watcher N. N.', '--role', 'guest');
  return lab;
}

export async function logIn(page, name, password = PASSWORD) {
  await page.locator('#name').fill(name);
  await page.locator('#password').fill(password);
  await page.getByRole('button', {name: 'Log in'}).click();
}
