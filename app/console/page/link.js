// The WebSocket: messages in, requests out; connects again by itself.
export class Link {
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.waiting = new Map();
    this.lastId = 0;
    this.wait = 500;
    this.open();
  }

  open() {
    const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
    this.socket = new WebSocket(`${scheme}//${location.host}/live`);
    this.socket.onopen = () => { this.wait = 500; this.onState(true); };
    this.socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.type === 'reply') {
        const resolve = this.waiting.get(message.id);
        this.waiting.delete(message.id);
        if (resolve) resolve(message);
      } else {
        this.onMessage(message);
      }
    };
    this.socket.onclose = () => {
      this.onState(false);
      for (const resolve of this.waiting.values()) resolve({ok: false, why: 'the connection was lost; check the state before you try again'});
      this.waiting.clear();
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, 8000);
    };
  }

  // The answer: {ok, why}.
  ask(request) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ok: false, why: 'there is no connection to the console'});
    const id = ++this.lastId;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      this.socket.send(JSON.stringify({...request, id}));
    });
  }
}
