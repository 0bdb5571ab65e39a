// Caches the files of the generator, so that a second visit loads nothing. Their folder is named after a hash of their content, so the
// files in a folder never change.
const GENERATOR_FOLDER = /\/files\/[0-9a-f]{12}\//;

addEventListener("install", () => skipWaiting());
addEventListener("activate", (event) => event.waitUntil(clients.claim()));

addEventListener("fetch", (event) => {
  if (event.request.method === "GET" && event.request.url.startsWith(registration.scope)) {
    event.respondWith(GENERATOR_FOLDER.test(event.request.url) ? fromCache(event.request) : fromNetwork(event.request));
  }
});

// Return a file from the cache. Load and cache a missing file.
async function fromCache(request) {
  const [folder] = request.url.match(GENERATOR_FOLDER);
  const cache = await caches.open(folder);
  const cached = await cache.match(request.url);
  if (cached) return cached;
  const response = await fetch(request);
  if (response.ok) {
    // Delete the caches of other versions.
    await Promise.all((await caches.keys()).map((name) => GENERATOR_FOLDER.test(name) && name !== folder && caches.delete(name)));
    await cache.put(request.url, response.clone());
  }
  return response;
}

// Load a file, and store it for visits without a network.
async function fromNetwork(request) {
  const cache = await caches.open("page");
  try {
    const response = await fetch(request);
    if (response.ok) await cache.put(request.url, response.clone());
    return response;
  } catch (error) {
    const cached = await cache.match(request.url);
    if (cached) return cached; // without a network, use the version of the last visit
    throw error;
  }
}
