// What the service sends: its answers, and the stream of what happens.

/** Called when the service asks who is there; a page that can sign in sets it. Resolves once it makes sense to ask again. */
let signIn;
export const onSignIn = (show) => (signIn = show);

/** How often a question is asked again that the service has no time for just now. */
const RETRIES = 3;

/** What the service takes with each change that a page makes in a session; nothing without one. */
let csrf;
export const inSession = (token) => (csrf = token);
export const changing = () => (csrf ? { 'x-echofix-csrf': csrf } : {});

/** Every request of the page goes this way. JSON of an address; throws the service's own words. */
async function call(path, options = {}) {
  const asked = () => ({ ...options, headers: { accept: 'application/json', ...(options.method ? changing() : {}), ...options.headers } });
  let response = await fetch(path, asked());
  for (let i = 0; response.status === 503 && !options.method && i < RETRIES; i += 1) {
    await new Promise((done) => setTimeout(done, 1000 * (Number(response.headers.get('retry-after')) || 1)));
    response = await fetch(path, asked());
  }
  if (response.status === 401 && signIn) {
    await signIn(response);
    response = await fetch(path, asked());
  }
  const body = await response.json().catch(() => undefined);
  if (response.ok) return body;
  const message = body?.error?.message ?? `${path} answered ${response.status}`;
  throw Object.assign(new Error(message), { status: response.status });
}

export const ask = (path) => call(path);

export const post = (path, body) =>
  call(path, { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) });

const KINDS = ['fix', 'upload', 'quarantine', 'map', 'health', 'missed', 'alive'];
const LONGEST_WAIT_MS = 5_000;
/** The service says something every two seconds; after this long without a word nothing that is shown can be relied on. */
const SILENT_MS = 4_500;

/**
 * Follows the event stream and takes it up again when it breaks or falls silent.
 *
 * `on` maps the kinds of events to functions; `on.open` is called on every (re)connection, so that
 * what was missed can be asked for, `on.lost` when the stream breaks.
 */
export function follow(on) {
  let failures = 0;
  const connect = () => {
    const source = new EventSource('api/v1/events');
    let silence;
    const wait = (ms) => {
      const from = Date.now();
      // A page that slept or was busy has not listened: it does, for a moment, before it says that nobody speaks.
      silence = setTimeout(() => (Date.now() - from > ms + 500 ? wait(1000) : lost()), ms);
    };
    const heard = () => {
      clearTimeout(silence);
      wait(SILENT_MS);
    };
    const lost = () => {
      clearTimeout(silence);
      source.close();
      failures += 1;
      on.lost();
      setTimeout(connect, Math.min(1000 * 2 ** (failures - 1), LONGEST_WAIT_MS));
    };
    heard();
    source.onopen = () => {
      failures = 0;
      heard();
      on.open();
    };
    for (const kind of KINDS) {
      source.addEventListener(kind, ({ data }) => {
        heard();
        on[kind]?.(data ? JSON.parse(data) : undefined);
      });
    }
    source.onerror = lost;
  };
  connect();
}
