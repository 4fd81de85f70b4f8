// What the page asks of the server. A request that fails for want of a connection is tried again.

const PAUSES_MS = [300, 1000, 2000, 4000, 8000];

async function ask(path, body) {
  const options = body === undefined ? {} : {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  for (const pause of [...PAUSES_MS, null]) {
    let response = null;
    try {
      response = await fetch(path, options);
    } catch (error) {
      if (pause === null) throw error;
    }
    document.body.classList.toggle("offline", response === null);
    const busy = response === null || response.status === 429 || response.status >= 500;
    if (!busy || pause === null) return { status: response.status, said: await response.json() };
    await new Promise((done) => setTimeout(done, pause));
  }
}

export const place = () => ask("/api/place");
export const welcome = () => ask("/api/welcome");
export const consent = (platformId) =>
  ask("/api/consent", platformId ? { agreed: true, platform_id: platformId } : { agreed: true });
export const begin = (position) => ask(`/api/assignments/${position}/begin`, {});
export const answer = (position, content) => ask(`/api/assignments/${position}/answer`, content);
