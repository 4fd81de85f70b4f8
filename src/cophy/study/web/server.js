// Requests to the server. A request that fails without a connection is sent again.

const PAUSES_MS = [300, 1000, 2000, 4000, 8000];
const SILENT = { status: 0, data: { error: "The server does not answer. Please load this page again in a minute." } };

// Whether the same request may succeed later, since nothing is wrong with it.
export const isBusy = (status) => status === 0 || status === 429 || status >= 500;

// A response that is not JSON comes from a proxy that cannot reach the server.
async function requestOnce(path, options) {
  try {
    const response = await fetch(path, options);
    return { status: response.status, data: await response.json() };
  } catch (error) {
    return SILENT;
  }
}

async function request(path, body) {
  const options = body === undefined ? {} : {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  for (const pause of [...PAUSES_MS, null]) {
    const result = await requestOnce(path, options);
    document.body.classList.toggle("offline", result === SILENT && pause !== null);
    if (!isBusy(result.status) || pause === null) return result;
    await new Promise((done) => setTimeout(done, pause));
  }
}

// Place of this browser's participant; 401 if a crowd platform sends another id.
export const place = (platformId) =>
  request(`/api/place${platformId ? `?platform_id=${encodeURIComponent(platformId)}` : ""}`);
export const welcome = () => request("/api/welcome");
// Drawn once, so that a consent whose response was lost is the same when it is sent again.
const token = btoa(String.fromCharCode(...crypto.getRandomValues(new Uint8Array(32))))
  .replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
export const consent = (platformId) =>
  request("/api/consent", { agreed: true, token, ...(platformId ? { platform_id: platformId } : {}) });
export const begin = (position) => request(`/api/assignments/${position}/begin`, {});
export const answer = (position, content) => request(`/api/assignments/${position}/answer`, content);
