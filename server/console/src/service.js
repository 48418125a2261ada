// What the service sends: its answers, and the stream of what happens.

import { signIn } from './signin.js';

/** JSON of an address; throws the service's own words. */
export async function ask(path) {
  let response = await fetch(path, { headers: { accept: 'application/json' } });
  if (response.status === 401) {
    await signIn();
    response = await fetch(path, { headers: { accept: 'application/json' } });
  }
  const body = await response.json().catch(() => undefined);
  if (response.ok) return body;
  const message = body?.error?.message ?? `${path} answered ${response.status}`;
  throw Object.assign(new Error(message), { status: response.status });
}

const KINDS = ['fix', 'upload', 'quarantine', 'map', 'health', 'missed'];
const LONGEST_WAIT_MS = 15_000;

/**
 * Follows the event stream and takes it up again when it breaks.
 *
 * `on` maps the kinds of events to functions; `on.open` is called on every (re)connection, so that
 * what was missed can be asked for, `on.lost` when the stream breaks.
 */
export function follow(on) {
  let failures = 0;
  const connect = () => {
    const source = new EventSource('/api/v1/events');
    source.onopen = () => {
      failures = 0;
      on.open();
    };
    for (const kind of KINDS) {
      source.addEventListener(kind, ({ data }) => on[kind]?.(JSON.parse(data)));
    }
    source.onerror = () => {
      source.close();
      failures += 1;
      on.lost();
      setTimeout(connect, Math.min(1000 * 2 ** (failures - 1), LONGEST_WAIT_MS));
    };
  };
  connect();
}
