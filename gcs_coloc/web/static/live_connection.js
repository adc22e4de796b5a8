// The WebSocket to the service, opened again whenever it is lost. Every second picture is acknowledged, with the one before, once it is drawn.

const FIRST_RETRY_S = 0.5;
const MOST_RETRY_S = 5;

// `handlers` take the messages by their kind, `picture` is the kind that is acknowledged; `opened` and `inSight` are called as they say.
export function openLive(handlers, picture, { opened = () => {}, inSight = () => {} } = {}) {
  let socket = null;
  let retryS = FIRST_RETRY_S;

  // A page out of sight needs no pictures.
  function sendVisibility() {
    if (socket?.readyState === WebSocket.OPEN) socket.send(document.hidden ? "hidden" : "visible");
  }

  document.addEventListener("visibilitychange", () => {
    if (!document.hidden) inSight();
    sendVisibility();
  });

  function connect() {
    let isOneShown = false;
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.addEventListener("open", () => {
      retryS = FIRST_RETRY_S;
      opened();
      if (document.hidden) sendVisibility();
    });
    socket.addEventListener("message", ({ data }) => {
      const message = JSON.parse(data);
      try {
        handlers[message.kind](message);
      } finally {
        if (message.kind === picture) {
          // The service sends no third picture before this.
          if (isOneShown && socket.readyState === WebSocket.OPEN) socket.send("both shown");
          isOneShown = !isOneShown;
        }
      }
    });
    socket.addEventListener("close", () => {
      setTimeout(connect, retryS * 1000);
      retryS = Math.min(retryS * 2, MOST_RETRY_S);
    });
  }

  connect();
}
