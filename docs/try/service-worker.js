// Keeps the files of the generator after the first visit. Their folder is named after their content, so they never change.
const GENERATOR = /\/files\/[0-9a-f]{12}\//;

addEventListener("install", () => skipWaiting());
addEventListener("activate", (event) => event.waitUntil(clients.claim()));

addEventListener("fetch", (event) => {
  if (event.request.method === "GET" && event.request.url.startsWith(registration.scope)) {
    event.respondWith(GENERATOR.test(event.request.url) ? fromCache(event.request) : fromNetwork(event.request));
  }
});

async function fromCache(request) {
  const [folder] = request.url.match(GENERATOR);
  const cache = await caches.open(folder);
  const cached = await cache.match(request.url);
  if (cached) return cached;
  const response = await fetch(request);
  if (response.ok) {
    await Promise.all((await caches.keys()).map((name) => GENERATOR.test(name) && name !== folder && caches.delete(name)));
    await cache.put(request.url, response.clone());
  }
  return response;
}

async function fromNetwork(request) {
  const cache = await caches.open("page");
  try {
    const response = await fetch(request);
    if (response.ok) await cache.put(request.url, response.clone());
    return response;
  } catch (error) {
    const cached = await cache.match(request.url);
    if (cached) return cached; // without a network the page works as it was last seen
    throw error;
  }
}
