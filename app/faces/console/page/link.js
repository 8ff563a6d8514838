import {t} from '/language.js';

// The connection of the page to the console by a WebSocket: messages in, requests out; connects again by itself. Knows when the
// bench was last heard: each second the bench sends a beat, which is answered.
export const SILENT_AFTER_MS = 3000;
export const UNCONFIRMED_AFTER_MS = 2000;

// As fetch(), but a missing answer is an error with a text of the page instead of one of the browser.
export async function fetched(path, options = {}, unanswered = 'there is no connection to the console') {
  try {
    return await fetch(path, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Error(unanswered);
  }
}

export class Link {
  // onMessage gets each message; onContact() is called each second and whenever contact begins or ends.
  constructor(onMessage, onContact) {
    this.onMessage = onMessage;
    this.onContact = onContact;
    this.waiting = new Map();
    this.lastId = 0;
    this.wait = 500;
    this.heard = null;     // performance.now() of the last beat
    this.heardUtc = null;  // The same moment by this computer's clock.
    this.open();
    setInterval(() => this.onContact(), 1000);
  }

  get connected() { return this.socket.readyState === WebSocket.OPEN; }
  // Time since the bench was last heard; Infinity: never.
  get silentMs() { return this.heard === null ? Infinity : performance.now() - this.heard; }
  get contact() { return this.connected && this.silentMs < SILENT_AFTER_MS; }

  open() {
    const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
    this.socket = new WebSocket(`${scheme}//${location.host}/live`);
    this.socket.onopen = () => { this.wait = 500; };
    this.socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    this.socket.onclose = () => {
      for (const resolve of this.waiting.values()) resolve({ok: false, lost: true, why: t('the connection was lost before the answer')});
      this.waiting.clear();
      this.onContact();
      this.askWho();
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, 8000);
    };
  }

  // Loads the page again if its visitor is not admitted any more: a WebSocket that is declined does not say why.
  async askWho() {
    try {
      if ((await fetch('/who')).status === 401) location.reload();
    } catch { /* No contact; the page says so. */ }
  }

  receive(message) {
    message.type ??= message.event;  // Events of a run state their type as `event`.
    if (message.type === 'reply') {
      const resolve = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (resolve) resolve(message);
      return;
    }
    // Only a beat, or the whole state at first, proves contact; any other message may be old.
    if (message.type === 'beat' || message.type === 'snapshot') {
      const before = this.contact;
      this.heard = performance.now();
      this.heardUtc = new Date();
      if (message.type === 'beat') this.socket.send('{"do":"beat"}');
      if (!before) this.onContact();
    }
    this.onMessage(message);
  }

  // Resolves to the answer {ok, why}. `lost`: none came, and it is unknown whether the request was carried out.
  ask(request) {
    if (!this.connected) return Promise.resolve({ok: false, unsent: true, why: t('there is no connection to the console')});
    const id = ++this.lastId;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      this.socket.send(JSON.stringify({...request, id}));
    });
  }
}
