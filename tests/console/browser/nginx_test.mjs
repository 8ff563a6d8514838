// The console behind nginx, with the configuration that docs/console_programs.md shows: it works, and counts failures by client.
import assert from 'node:assert/strict';
import {execFileSync, spawn} from 'node:child_process';
import {existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import https from 'node:https';
import {createServer} from 'node:net';
import {tmpdir} from 'node:os';
import path from 'node:path';
import {after, before, test} from 'node:test';
import {fileURLToPath} from 'node:url';
import {eventually} from './driven_page.mjs';

const NGINX = '/usr/sbin/nginx';
if (!existsSync(NGINX)) {
  console.log(`skipped: there is no ${NGINX} (scripts/setup --tests installs it)`);
  process.exit(77);  // ctest's SKIP_RETURN_CODE
}
const docs = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/console_programs.md');
const folder = mkdtempSync(path.join(tmpdir(), 'abcal-nginx-'));
const TOKEN = '0123456789abcdef';
const BENCH = `
[bench]
g_loc_mps2 = 9.81
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
`;
let console_, nginx, port, said = '';
const watchdog = setTimeout(() => { console.error('not over after 50 s'); end(); process.exit(1); }, 50_000);

const freePort = () => new Promise((resolve) => {
  const server = createServer();
  server.listen(0, '127.0.0.1', () => { const {port} = server.address(); server.close(() => resolve(port)); });
});

function end() {
  nginx?.kill('SIGKILL');
  console_?.kill('SIGINT');
  rmSync(folder, {recursive: true, force: true, maxRetries: 20, retryDelay: 100});
}

// The configuration of the docs, with the ports and files of this test.
function configuration(upstream) {
  const shown = readFileSync(docs, 'utf8').match(/```nginx\n([\s\S]*?)```/)[1];
  const here = shown.replace('listen 443 ssl', `listen 127.0.0.1:${port} ssl`).replace('127.0.0.1:8474', `127.0.0.1:${upstream}`)
    .replace('/etc/ssl/bench.crt', `${folder}/bench.crt`).replace('/etc/ssl/bench.key', `${folder}/bench.key`);
  const places = ['client_body', 'proxy', 'fastcgi', 'uwsgi', 'scgi'].map((kind) => `${kind}_temp_path ${folder}/${kind};`).join('\n');
  return `daemon off; master_process off; pid ${folder}/pid; error_log stderr;\nevents {}\nhttp {\naccess_log off;\n${places}\n${here}}\n`;
}

before(async () => {
  port = await freePort();
  writeFileSync(path.join(folder, 'bench.toml'), BENCH);
  writeFileSync(path.join(folder, 'token'), `${TOKEN}\n`, {mode: 0o600});
  mkdirSync(path.join(folder, 'runs'));
  execFileSync('openssl', ['req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes', '-subj', '/CN=bench.example.org',
    '-keyout', `${folder}/bench.key`, '-out', `${folder}/bench.crt`], {stdio: 'ignore'});
  console_ = spawn(process.env.ABCAL_PROGRAM, ['serve', 'bench.toml', '--runs', 'runs', '--port', '0', '--token-file', 'token',
    '--host', `bench.example.org:${port}`, '--trusted-proxy', '127.0.0.1'], {cwd: folder, stdio: ['ignore', 'pipe', 'pipe']});
  console_.stderr.on('data', (bytes) => { said += bytes; });
  const upstream = await new Promise((resolve, reject) => {
    let out = '';
    console_.stdout.on('data', (bytes) => {
      out += bytes;
      const found = out.match(/Console: http:\/\/[^:]*:(\d+)\//);
      if (found) resolve(found[1]);
    });
    console_.on('exit', (code) => reject(new Error(`abcal serve ended with ${code}: ${said}`)));
  });
  writeFileSync(path.join(folder, 'nginx.conf'), configuration(upstream));
  nginx = spawn(NGINX, ['-e', 'stderr', '-p', folder, '-c', path.join(folder, 'nginx.conf')], {stdio: ['ignore', 'inherit', 'inherit']});
  for (;;) {
    try { await ask('GET', '/'); break; } catch { await new Promise((resolve) => setTimeout(resolve, 20)); }
  }
});
after(() => { end(); clearTimeout(watchdog); });

// One request; `from` is the local address of the connection, which nginx takes for the client's address.
function ask(method, target, {headers = {}, body = '', from = '127.0.0.2'} = {}) {
  return new Promise((resolve, reject) => {
    const request = https.request({host: '127.0.0.1', port, localAddress: from, method, path: target, rejectUnauthorized: false, agent: false,
      headers: {Host: `bench.example.org:${port}`, Origin: `https://bench.example.org:${port}`, 'Content-Type': 'application/x-www-form-urlencoded', ...headers}});
    request.on('response', (response) => { response.resume(); resolve({status: response.statusCode, headers: response.headers}); });
    request.on('upgrade', (response, socket) => { socket.destroy(); resolve({status: response.statusCode, headers: response.headers}); });
    request.on('error', reject);
    request.end(body);
  });
}

test('a token is asked for, its cookie stays with TLS, and page and WebSocket pass', async () => {
  assert.equal((await ask('GET', '/')).status, 401);
  const welcome = await ask('POST', '/login', {body: `token=${TOKEN}`});
  assert.equal(welcome.status, 303);
  const [cookie] = welcome.headers['set-cookie'];
  assert.match(cookie, /; Secure/);
  const headers = {Cookie: cookie.split(';')[0]};
  assert.equal((await ask('GET', '/', {headers})).status, 200);
  const live = {Connection: 'Upgrade', Upgrade: 'websocket', 'Sec-WebSocket-Version': '13', 'Sec-WebSocket-Key': 'dGhlIHNhbXBsZSBub25jZQ=='};
  assert.equal((await ask('GET', '/live', {headers: {...headers, ...live}})).status, 101);
  assert.equal((await ask('GET', '/live', {headers: live})).status, 401);
  assert.equal((await ask('GET', '/', {headers: {...headers, Origin: 'https://evil.example.org'}})).status, 403);
});

test('who guesses has to wait, whatever they say of themselves, and others do not', async () => {
  const guess = (token, more) => ask('POST', '/login', {body: `token=${token}`, from: '127.0.0.3', ...more});
  for (let i = 0; i < 5; ++i)
    assert.equal((await guess('guess', {headers: {'X-Forwarded-For': `192.0.2.${i}`, Forwarded: `for=192.0.2.${i}`}})).status, 401);
  // The wait is a second, and twice as long after each further guess: a slow machine may need several guesses.
  let status = 0;
  for (let i = 0; i < 5 && status !== 429; ++i) {
    await guess('guess');
    ({status} = await guess(TOKEN));
  }
  assert.equal(status, 429);
  assert.equal((await guess(TOKEN, {from: '127.0.0.4'})).status, 303);
  await eventually(() => assert.match(said, /refused from 127\.0\.0\.3 by 127\.0\.0\.1:\d+: POST \/login/));  // The log arrives through a pipe.
});
