// What the page asks of the server. A request that fails for want of a connection is tried again.

const PAUSES_MS = [300, 1000, 2000, 4000, 8000];
const SILENT = { status: 0, said: { error: "The server does not answer. Please load this page again in a minute." } };

// Whether the same request may do later, for nothing was wrong with it.
export const isBusy = (status) => status === 0 || status === 429 || status >= 500;

// What is no JSON is not of our server, but of one in front of it, which cannot reach ours.
async function askOnce(path, options) {
  try {
    const response = await fetch(path, options);
    return { status: response.status, said: await response.json() };
  } catch (error) {
    return SILENT;
  }
}

async function ask(path, body) {
  const options = body === undefined ? {} : {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  for (const pause of [...PAUSES_MS, null]) {
    const answered = await askOnce(path, options);
    document.body.classList.toggle("offline", answered === SILENT && pause !== null);
    if (!isBusy(answered.status) || pause === null) return answered;
    await new Promise((done) => setTimeout(done, pause));
  }
}

// Of whoever has this browser's cookie; nobody's where a platform calls them otherwise.
export const place = (platformId) =>
  ask(`/api/place${platformId ? `?platform_id=${encodeURIComponent(platformId)}` : ""}`);
export const welcome = () => ask("/api/welcome");
// Drawn once, so that a consent whose answer was lost is the same when it is sent again.
const token = btoa(String.fromCharCode(...crypto.getRandomValues(new Uint8Array(32))))
  .replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
export const consent = (platformId) =>
  ask("/api/consent", { agreed: true, token, ...(platformId ? { platform_id: platformId } : {}) });
export const begin = (position) => ask(`/api/assignments/${position}/begin`, {});
export const answer = (position, content) => ask(`/api/assignments/${position}/answer`, content);
