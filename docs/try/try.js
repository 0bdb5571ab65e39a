// The page "Generate in the browser": stores the user's input, requests the result from worker.js, and displays the result.
const EMPTY = { source: "jazzy", files: {}, messages: [], topics: [], bounds: {} };
const byId = (id) => document.getElementById(id);
let state = structuredClone(EMPTY); // the user's input, described in generator.py
let result = { files: {}, messages: [], missing: [], diagnostics: [], toml: "" };
let currentPath = ""; // path of the file in the editor
const SUFFIXES = ["msg", "srv", "action"]; // of files that the user opens without a package; they become part of the package my_msgs

// ---- calls of worker.js: the worker answers each call with one message ----
const pendingCalls = new Map(); // id of a call -> functions that settle its promise
let worker, lastId = 0;

function callWorker(call, ...args) {
  return new Promise((resolve, reject) => {
    pendingCalls.set(++lastId, { resolve, reject });
    worker.postMessage({ id: lastId, call, args });
  });
}

function startWorker() {
  worker = new Worker("worker.js", { type: "module" });
  worker.onmessage = ({ data }) => {
    const { resolve, reject } = pendingCalls.get(data.id);
    pendingCalls.delete(data.id);
    "error" in data ? reject(new Error(data.error)) : resolve(data.result);
  };
  worker.onerror = (event) => setStatus(`The generator cannot start: ${event.message}`);
}

// ---- start: download the files of the generator, display the progress, then start Python ----
async function start() {
  const response = await fetch("manifest.json").catch(() => null);
  if (!response?.ok) return setStatus("This copy of the documentation was built without the generator. To add the generator, install npm and run `make site`.");
  const manifest = await response.json();
  await registerServiceWorker();
  await downloadGenerator(manifest);
  setStatus("Starting Python …");
  startWorker();
  await callWorker("start", new URL(manifest.folder, location.href).href);
  byId("source").replaceChildren(...manifest.sources.map((name) => element("option", { value: name }, name)));
  byId("progress").hidden = true;
  await restoreInput();
}

async function registerServiceWorker() {
  if (!navigator.serviceWorker) return; // browsers offer service workers only on secure pages (https or localhost)
  try {
    await navigator.serviceWorker.register("service-worker.js");
    await navigator.serviceWorker.ready;
    if (!navigator.serviceWorker.controller) {
      await new Promise((resolve) => {
        navigator.serviceWorker.addEventListener("controllerchange", resolve, { once: true });
        setTimeout(resolve, 2000);
      });
    }
  } catch { /* the page works without its cache */ }
}

async function downloadGenerator({ folder, sizes }) {
  const totalBytes = Object.values(sizes).reduce((sum, size) => sum + size, 0);
  let loadedBytes = 0;
  await Promise.all(Object.keys(sizes).map(async (name) => {
    const reader = (await fetch(folder + name)).body.getReader();
    for (let chunk = await reader.read(); !chunk.done; chunk = await reader.read()) {
      loadedBytes += chunk.value.length;
      byId("progress").value = loadedBytes / totalBytes;
      setStatus(`Loading Python and shmgen: ${(loadedBytes / 1e6).toFixed(1)} of ${(totalBytes / 1e6).toFixed(1)} MB`);
    }
  }));
}

// ---- the input ----
let timer, newestRequest = 0;

// Generate when the input has not changed for 200 ms.
function generateSoon() {
  clearTimeout(timer);
  timer = setTimeout(generate, 200);
}

async function generate() {
  const request = ++newestRequest;
  localStorage.setItem("shmgen", JSON.stringify(state));
  const newResult = await callWorker("run", state).catch((error) => ({ ...result, files: {}, messages: [], missing: [], diagnostics: [{ path: "", text: error.message }] }));
  if (request !== newestRequest) return; // a newer request will replace this result
  const hasOtherMessages = result.messages.length !== newResult.messages.length;
  result = newResult;
  showInput();
  showResult();
  if (hasOtherMessages) selectMessageOf(currentPath);
}

function showInput() {
  byId("source").value = state.source;
  byId("messages").replaceChildren(...state.messages.map((name) => removableItem(element("span", {}, name), name, () => {
    state.messages = state.messages.filter((other) => other !== name);
  })));
  byId("files").replaceChildren(...Object.keys(state.files).map((path) => removableItem(
    element("button", { type: "button", ariaCurrent: String(path === currentPath), onclick: () => openInEditor(path) }, path), path, () => {
      delete state.files[path];
      if (path === currentPath) openInEditor(Object.keys(state.files)[0] ?? "");
    })));
  byId("diagnostics").replaceChildren(...result.diagnostics.filter(({ code }) => code !== "SHM101").map((diagnostic) => element("li", {},
    diagnostic.path in state.files && diagnostic.line ? element("button", { type: "button", onclick: () => selectInEditor(diagnostic) }, `Go to ${diagnostic.path}, line ${diagnostic.line}`) : "",
    element("pre", {}, diagnostic.text))));
  showBounds();
  showTopics();
}

// Return a list item with a button that removes it.
function removableItem(label, name, remove) {
  const button = element("button", { type: "button", ariaLabel: `Remove ${name}`, onclick: () => { remove(); showInput(); generateSoon(); } }, "×");
  return element("li", {}, label, button);
}

// Display a file in the editor. If `path` is "", the editor is empty and disabled.
function openInEditor(path) {
  currentPath = path;
  byId("editor").disabled = !path;
  byId("editor").value = state.files[path] ?? "";
  selectMessageOf(path);
  for (const button of byId("files").querySelectorAll("[aria-current]")) button.ariaCurrent = String(button.textContent === path);
}

// Select the text of a diagnostic or of an unbounded field. `line` and `column` start at 1.
function selectInEditor({ path, line, column, width }) {
  openInEditor(path);
  const editor = byId("editor"), lines = editor.value.split("\n");
  const start = lines.slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0) + Math.max(0, column - 1);
  editor.focus();
  editor.setSelectionRange(start, start + Math.max(1, width));
}

function showBounds() {
  const bounds = Object.entries(state.bounds).map(([key, value]) => ({ key, value }));
  const missingBounds = result.missing.map((missing) => ({ ...missing, value: missing.proposed, isMissing: true }));
  if (byId("bounds").contains(document.activeElement) && byId("bounds").elements.length === 2 * (bounds.length + missingBounds.length)) return; // the user types here
  byId("bounds").replaceChildren(...[...missingBounds, ...bounds].map((bound) => {
    const input = element("input", { type: "number", min: 1, max: 1e6, value: bound.value, required: true });
    const apply = () => { if (input.reportValidity()) { state.bounds[bound.key] = input.valueAsNumber; generateSoon(); } };
    const lineButton = bound.path in state.files ? element("button", { type: "button", onclick: () => selectInEditor(bound) }, `Line ${bound.line}`) : "";
    const button = bound.isMissing
      ? element("button", { type: "button", onclick: apply }, "Use this bound")
      : element("button", { type: "button", ariaLabel: `Remove the bound of ${bound.key}`, onclick: () => { delete state.bounds[bound.key]; generateSoon(); } }, "×");
    if (!bound.isMissing) input.onchange = apply;
    const text = bound.isMissing ? ` (${bound.type}) has no bound. It holds at most ` : " holds at most ";
    return element("label", { className: bound.isMissing ? "missing" : "" }, element("code", {}, bound.key), text, input, " elements", button, lineButton);
  }));
}

function typesOfTopics() {
  return [...new Set([...state.messages, ...result.messages.map(({ type }) => type), ...state.topics.map(({ type }) => type)])].sort();
}

function showTopics() {
  const body = byId("topics").tBodies[0];
  if (body.contains(document.activeElement) && body.rows.length === state.topics.length) return; // the user types here
  body.replaceChildren(...state.topics.map((topic, index) => {
    const store = (key, valueOf) => ({ target }) => { topic[key] = valueOf(target); generateSoon(); };
    const choice = (key, label, options) => element("select", { ariaLabel: label, onchange: store(key, (input) => input.value) },
      ...options.map(([value, text]) => element("option", { value, selected: value === topic[key] }, text)));
    const cells = [
      element("input", { ariaLabel: "Topic", value: topic.topic, oninput: store("topic", (input) => input.value) }),
      choice("type", "Type", typesOfTopics().map((type) => [type, type])),
      choice("direction", "Direction", [["to_plc", "ROS to PLC"], ["from_plc", "PLC to ROS"]]),
      element("input", { ariaLabel: "Depth in samples", type: "number", min: 1, value: topic.depth, oninput: store("depth", (input) => input.valueAsNumber || 1) }),
      element("button", { type: "button", ariaLabel: `Remove ${topic.topic}`, onclick: () => { state.topics.splice(index, 1); showTopics(); generateSoon(); } }, "×"),
    ];
    return element("tr", {}, ...cells.map((cell) => element("td", {}, cell)));
  }));
}

async function addFiles(files) {
  const added = {};
  for (const file of files) {
    const suffix = file.name.split(".").pop(), content = await file.arrayBuffer();
    try {
      if (suffix === "zip") Object.assign(added, await callWorker("unpackZip", file.name, content));
      else if (SUFFIXES.includes(suffix)) added[`my_msgs/${suffix}/${file.name}`] = new TextDecoder("utf-8", { fatal: true }).decode(content);
    } catch (error) {
      return setStatus(`${file.name} cannot be read: ${error.message.trim().split("\n").pop()}`);
    }
  }
  if (!Object.keys(added).length) return setStatus("These files contain no definition (.msg, .srv, .action). Choose other files, or the zip of a package.");
  Object.assign(state.files, added);
  openInEditor(Object.keys(added).find((path) => !path.endsWith(".xml")) ?? "");
  generateSoon();
}

// ---- the result ----
function showResult() {
  const isComplete = Object.keys(result.files).length > 0;
  byId("xml").disabled = byId("zip").disabled = !isComplete;
  byId("toml").textContent = result.toml;
  setOptions("message", result.messages.map(({ type }) => type));
  setOptions("file", Object.keys(result.files));
  byId("output").hidden = !isComplete;
  showMessage();
  const errors = result.diagnostics.length;
  if (isComplete) setStatus(`Ready: ${result.messages.length} message${result.messages.length === 1 ? "" : "s"}, ${Object.keys(result.files).length} files.`);
  else if (result.missing.length) setStatus("A sequence needs a bound: see below the definitions.");
  else setStatus(errors ? `${errors} ${errors === 1 ? "error" : "errors"}: see below the definitions.` : "Choose a message, or create or open a definition.");
}

// Display the message whose definition is in the editor.
function selectMessageOf(path) {
  const [folder, , file] = path.split("/"), name = file?.split(".")[0];
  const message = result.messages.find(({ type }) => type === `${folder}/${name}` || type.startsWith(`${folder}/${name}_`));
  if (!message) return;
  byId("message").value = message.type;
  showMessage();
}

// Replace the options of a list, and keep the selection if it is still an option.
function setOptions(id, values) {
  const list = byId(id), selection = list.value;
  list.replaceChildren(...values.map((value) => element("option", { value }, value)));
  if (values.includes(selection)) list.value = selection;
}

function showMessage() {
  const message = result.messages.find(({ type }) => type === byId("message").value);
  byId("picture").innerHTML = message?.svg ?? ""; // safe, because shmgen escapes all text in the picture
  const header = element("tr", {}, ...["Offset", "Size", "Name", "ROS", "IEC 61131-3"].map((text, index) => element("th", { scope: "col", className: index < 2 ? "number" : "" }, text)));
  byId("layout").replaceChildren(...(message ? [header] : []), ...(message?.slots ?? []).map((slot) => element("tr", { className: slot.role },
    element("td", { className: "number" }, slot.offset), element("td", { className: "number" }, slot.size),
    element("td", {}, "\u2003".repeat(slot.depth) + slot.path.split(".").pop()), element("td", {}, slot.ros), element("td", {}, slot.iec))));
  if (message) {
    const [folder, name] = message.type.split("/");
    const path = `st/${folder}/ST_${folder}_${name}.st`;
    if (path in result.files) byId("file").value = path;
  }
  showFile();
}

// Patterns for the colours of Structured Text.
const KEYWORDS = "ARRAY|CASE|CONSTANT|DO|ELSE|ELSIF|END_\\w+|EXTENDS|FALSE|FOR|FUNCTION|FUNCTION_BLOCK|IF|METHOD|NOT|AND|OR|XOR|MOD|OF|PROGRAM|REPEAT|RETURN|STRUCT|THEN|TO|TRUE|TYPE|UNTIL|VAR\\w*|WHILE|AT|BY|EXIT";
const TYPES = "BOOL|BYTE|D?WORD|LWORD|U?[SDL]?INT|L?REAL|W?STRING|L?TIME|POINTER|REFERENCE|(?:ST|FB|GVL|E|PRG)_\\w+";
const TOKENS = new RegExp(`(?<comment>\\(\\*[^]*?\\*\\)|//.*|\\{.*?\\})|(?<string>'(?:\\$.|[^'$])*'|"(?:\\$.|[^"$])*")|(?<value>\\b(?:L?T)?#?\\d[\\w#.]*)|(?<keyword>\\b(?:${KEYWORDS})\\b)|(?<type>\\b(?:${TYPES})\\b)`, "g");

function showFile() {
  const path = byId("file").value, text = result.files[path] ?? "", parts = [];
  let end = 0;
  for (const match of path.endsWith(".st") ? text.matchAll(TOKENS) : []) {
    const [kind] = Object.entries(match.groups).find(([, value]) => value !== undefined);
    parts.push(text.slice(end, match.index), element("span", { className: kind }, match[0]));
    end = match.index + match[0].length;
  }
  byId("text").replaceChildren(...parts, text.slice(end));
}

// Let the browser save a file under `name`.
function saveFile(name, content, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

// ---- the link that contains the input, and the input of the last visit ----

// Compress text, or decompress bytes. `Stream` is CompressionStream or DecompressionStream.
async function convertBytes(input, Stream) {
  return new Uint8Array(await new Response(new Blob([input]).stream().pipeThrough(new Stream("deflate-raw"))).arrayBuffer());
}

// Put the input into the fragment of the address, in base64 for URLs, and return the address.
async function createLink() {
  const bytes = await convertBytes(JSON.stringify(state), CompressionStream);
  const code = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")).replace(/[+/=]/g, (character) => ({ "+": "-", "/": "_", "=": "" })[character]);
  history.replaceState(null, "", `#${code}`);
  return location.href;
}

// Restore the input from the link, or from the last visit.
async function restoreInput() {
  try {
    if (location.hash.length > 1) {
      const code = atob(location.hash.slice(1).replace(/[-_]/g, (character) => ({ "-": "+", _: "/" })[character]));
      const bytes = await convertBytes(Uint8Array.from(code, (character) => character.charCodeAt(0)), DecompressionStream);
      state = { ...structuredClone(EMPTY), ...JSON.parse(new TextDecoder().decode(bytes)) };
    } else {
      state = { ...structuredClone(EMPTY), ...JSON.parse(localStorage.getItem("shmgen") ?? "{}") };
    }
  } catch {
    setStatus("The input in this link, or the input of your last visit, is damaged. The page starts empty.");
  }
  openInEditor(Object.keys(state.files).find((path) => !path.endsWith(".xml")) ?? "");
  await setSource(state.source);
}

async function setSource(source) {
  state.source = source;
  byId("types").replaceChildren(...(await callWorker("types", source)).map((value) => element("option", { value })));
  await generate();
}

// ---- helpers ----
function element(tag, properties, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children);
  return node;
}

function setStatus(text) {
  byId("status").textContent = text;
}

async function copyToClipboard(text, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    return setStatus("The browser does not allow copying here. The link is in the address bar.");
  }
  const label = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = label; }, 1500);
}

byId("choose").onsubmit = (event) => {
  event.preventDefault();
  const name = byId("search").value.trim().replace("/msg/", "/");
  if (!name || state.messages.includes(name)) return;
  state.messages.push(name);
  byId("search").value = "";
  generateSoon();
};
byId("new-file").onsubmit = (event) => {
  event.preventDefault();
  const path = byId("path").value.trim();
  state.files[path] ??= "";
  byId("path").value = "";
  openInEditor(path);
  byId("editor").focus();
  generateSoon();
};
byId("editor").oninput = ({ target }) => { state.files[currentPath] = target.value; generateSoon(); };
byId("open").onchange = ({ target }) => addFiles([...target.files]).then(() => { target.value = ""; });
byId("bounds").onsubmit = (event) => event.preventDefault();
byId("source").onchange = ({ target }) => setSource(target.value);
byId("message").onchange = showMessage;
byId("file").onchange = showFile;
byId("add-topic").onclick = () => {
  const [type] = typesOfTopics();
  if (!type) return setStatus("Choose a message first: a topic carries messages of one type.");
  state.topics.push({ topic: `/topic${state.topics.length + 1}`, type, direction: "to_plc", depth: 1 });
  showTopics();
  generateSoon();
};
byId("xml").onclick = () => saveFile("shmgen.xml", result.files["plcopen/shmgen.xml"], "application/xml");
byId("zip").onclick = async () => saveFile("shmgen.zip", await callWorker("packZip", state, result.files), "application/zip");
byId("copy-toml").onclick = ({ target }) => copyToClipboard(result.toml, target);
byId("link").onclick = async ({ target }) => copyToClipboard(await createLink(), target);
byId("editor").ondragover = byId("try").ondragover = (event) => { event.preventDefault(); byId("editor").classList.add("drop"); };
byId("try").ondragleave = () => byId("editor").classList.remove("drop");
byId("try").ondrop = (event) => { event.preventDefault(); byId("editor").classList.remove("drop"); addFiles([...event.dataTransfer.files]); };

start().catch((error) => setStatus(`The generator cannot start: ${error.message}`));
