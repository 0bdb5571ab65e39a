// The page "Generate in the browser": keeps the user's input, asks the worker for the result, and shows it.
const EMPTY = { source: "jazzy", files: {}, messages: [], topics: [], bounds: {} };
const find = (id) => document.getElementById(id);
let state = structuredClone(EMPTY), result = { files: {}, messages: [], missing: [], diagnostics: [], toml: "" };
let current = ""; // path of the file in the editor
const SUFFIXES = ["msg", "srv", "action"]; // of single files, which become part of the package my_msgs

// ---- the worker: one call at a time, each answered once ----
const waiting = new Map();
let worker, number = 0;

function ask(call, ...args) {
  return new Promise((resolve, reject) => {
    waiting.set(++number, { resolve, reject });
    worker.postMessage({ id: number, call, args });
  });
}

function startWorker() {
  worker = new Worker("worker.js", { type: "module" });
  worker.onmessage = ({ data }) => {
    const { resolve, reject } = waiting.get(data.id);
    waiting.delete(data.id);
    "error" in data ? reject(new Error(data.error)) : resolve(data.result);
  };
  worker.onerror = (event) => setStatus(`The generator cannot start: ${event.message}`);
}

// ---- start: load the files once with progress, then Python ----
async function start() {
  const response = await fetch("manifest.json").catch(() => null);
  if (!response?.ok) return setStatus("This copy of the documentation was built without the generator. `make site` needs npm to add it.");
  const manifest = await response.json();
  await registerServiceWorker();
  await download(manifest);
  setStatus("Starting Python …");
  startWorker();
  await ask("start", new URL(manifest.folder, location.href).href);
  find("source").replaceChildren(...manifest.sources.map((name) => element("option", { value: name }, name)));
  find("progress").hidden = true;
  await restore();
}

async function registerServiceWorker() {
  if (!navigator.serviceWorker) return; // a page that is not secure is not cached
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

async function download({ folder, sizes }) {
  const total = Object.values(sizes).reduce((sum, size) => sum + size, 0);
  let loaded = 0;
  await Promise.all(Object.keys(sizes).map(async (name) => {
    const reader = (await fetch(folder + name)).body.getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      loaded += part.value.length;
      find("progress").value = loaded / total;
      setStatus(`Loading Python and shmgen: ${(loaded / 1e6).toFixed(1)} of ${(total / 1e6).toFixed(1)} MB`);
    }
  }));
}

// ---- the input ----
let timer, newest = 0;

function changed() {
  clearTimeout(timer);
  timer = setTimeout(generate, 200);
}

async function generate() {
  const turn = ++newest;
  localStorage.setItem("shmgen", JSON.stringify(state));
  const answer = await ask("run", state).catch((error) => ({ ...result, files: {}, messages: [], missing: [], diagnostics: [{ path: "", text: error.message }] }));
  if (turn !== newest) return; // a newer input is on its way
  const isNew = result.messages.length !== answer.messages.length;
  result = answer;
  showInput();
  showResult();
  if (isNew) showMessageOf(current);
}

function showInput() {
  find("source").value = state.source;
  find("messages").replaceChildren(...state.messages.map((name) => chip(element("span", {}, name), name, () => {
    state.messages = state.messages.filter((other) => other !== name);
  })));
  find("files").replaceChildren(...Object.keys(state.files).map((path) => chip(
    element("button", { type: "button", ariaCurrent: String(path === current), onclick: () => edit(path) }, path), path, () => {
      delete state.files[path];
      if (path === current) edit(Object.keys(state.files)[0] ?? "");
    })));
  find("diagnostics").replaceChildren(...result.diagnostics.filter(({ code }) => code !== "SHM101").map((found) => element("li", {},
    found.path in state.files && found.line ? element("button", { type: "button", onclick: () => select(found) }, `Go to ${found.path}, line ${found.line}`) : "",
    element("pre", {}, found.text))));
  showBounds();
  showTopics();
}

function chip(label, name, remove) {
  const button = element("button", { type: "button", ariaLabel: `Remove ${name}`, onclick: () => { remove(); showInput(); changed(); } }, "×");
  return element("li", {}, label, button);
}

function edit(path) {
  current = path;
  find("editor").disabled = !path;
  find("editor").value = state.files[path] ?? "";
  showMessageOf(path);
  for (const button of find("files").querySelectorAll("[aria-current]")) button.ariaCurrent = String(button.textContent === path);
}

function select({ path, line, column, width }) {
  edit(path);
  const editor = find("editor"), lines = editor.value.split("\n");
  const begin = lines.slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0) + Math.max(0, column - 1);
  editor.focus();
  editor.setSelectionRange(begin, begin + Math.max(1, width));
}

function showBounds() {
  const given = Object.entries(state.bounds).map(([key, value]) => ({ key, value }));
  const asked = result.missing.map((found) => ({ ...found, value: found.proposed, isMissing: true }));
  if (find("bounds").contains(document.activeElement) && find("bounds").elements.length === 2 * (given.length + asked.length)) return;
  find("bounds").replaceChildren(...[...asked, ...given].map((bound) => {
    const input = element("input", { type: "number", min: 1, max: 1e6, value: bound.value, required: true });
    const apply = () => { if (input.reportValidity()) { state.bounds[bound.key] = input.valueAsNumber; changed(); } };
    const place = bound.path in state.files ? element("button", { type: "button", onclick: () => select(bound) }, `Line ${bound.line}`) : "";
    const button = bound.isMissing
      ? element("button", { type: "button", onclick: apply }, "Use this bound")
      : element("button", { type: "button", ariaLabel: `Remove the bound of ${bound.key}`, onclick: () => { delete state.bounds[bound.key]; changed(); } }, "×");
    if (!bound.isMissing) input.onchange = apply;
    const words = bound.isMissing ? ` (${bound.type}) has no bound. It holds at most ` : " holds at most ";
    return element("label", { className: bound.isMissing ? "missing" : "" }, element("code", {}, bound.key), words, input, " elements", button, place);
  }));
}

function typesOfTopics() {
  return [...new Set([...state.messages, ...result.messages.map(({ type }) => type), ...state.topics.map(({ type }) => type)])].sort();
}

function showTopics() {
  const body = find("topics").tBodies[0];
  if (body.contains(document.activeElement) && body.rows.length === state.topics.length) return;
  body.replaceChildren(...state.topics.map((topic, index) => {
    const set = (key, read) => ({ target }) => { topic[key] = read(target); changed(); };
    const choice = (key, label, options) => element("select", { ariaLabel: label, onchange: set(key, (it) => it.value) },
      ...options.map(([value, text]) => element("option", { value, selected: value === topic[key] }, text)));
    const cells = [
      element("input", { ariaLabel: "Topic", value: topic.topic, oninput: set("topic", (it) => it.value) }),
      choice("type", "Type", typesOfTopics().map((type) => [type, type])),
      choice("direction", "Direction", [["to_plc", "ROS to PLC"], ["from_plc", "PLC to ROS"]]),
      element("input", { ariaLabel: "Depth in samples", type: "number", min: 1, value: topic.depth, oninput: set("depth", (it) => it.valueAsNumber || 1) }),
      element("button", { type: "button", ariaLabel: `Remove ${topic.topic}`, onclick: () => { state.topics.splice(index, 1); showTopics(); changed(); } }, "×"),
    ];
    return element("tr", {}, ...cells.map((cell) => element("td", {}, cell)));
  }));
}

async function openFiles(files) {
  const added = {};
  for (const file of files) {
    const suffix = file.name.split(".").pop(), content = await file.arrayBuffer();
    try {
      if (suffix === "zip") Object.assign(added, await ask("unzipped", file.name, content));
      else if (SUFFIXES.includes(suffix)) added[`my_msgs/${suffix}/${file.name}`] = new TextDecoder("utf-8", { fatal: true }).decode(content);
    } catch (error) {
      return setStatus(`${file.name} cannot be read: ${error.message.trim().split("\n").pop()}`);
    }
  }
  if (!Object.keys(added).length) return setStatus("These files hold no definition (.msg, .srv, .action). Choose others, or the zip of a package.");
  Object.assign(state.files, added);
  edit(Object.keys(added).find((path) => !path.endsWith(".xml")) ?? "");
  changed();
}

// ---- the result ----
function showResult() {
  const isComplete = Object.keys(result.files).length > 0;
  find("xml").disabled = find("zip").disabled = !isComplete;
  find("toml").textContent = result.toml;
  fill("message", result.messages.map(({ type }) => type));
  fill("file", Object.keys(result.files));
  find("output").hidden = !isComplete;
  showMessage();
  const errors = result.diagnostics.length;
  if (isComplete) setStatus(`Ready: ${result.messages.length} message${result.messages.length === 1 ? "" : "s"}, ${Object.keys(result.files).length} files.`);
  else if (result.missing.length) setStatus("A sequence needs a bound: see below the definitions.");
  else setStatus(errors ? `${errors} ${errors === 1 ? "error" : "errors"}: see below the definitions.` : "Choose a message, or create or open a definition.");
}

// Shows the message whose definition is in the editor.
function showMessageOf(path) {
  const [folder, , file] = path.split("/"), name = file?.split(".")[0];
  const found = result.messages.find(({ type }) => type === `${folder}/${name}` || type.startsWith(`${folder}/${name}_`));
  if (!found) return;
  find("message").value = found.type;
  showMessage();
}

function fill(id, values) {
  const list = find(id), before = list.value;
  list.replaceChildren(...values.map((value) => element("option", { value }, value)));
  if (values.includes(before)) list.value = before;
}

function showMessage() {
  const message = result.messages.find(({ type }) => type === find("message").value);
  find("picture").innerHTML = message?.svg ?? ""; // drawn by shmgen, with all text escaped
  const head = element("tr", {}, ...["Offset", "Size", "Name", "ROS", "IEC 61131-3"].map((text, index) => element("th", { scope: "col", className: index < 2 ? "number" : "" }, text)));
  find("layout").replaceChildren(...(message ? [head] : []), ...(message?.slots ?? []).map((slot) => element("tr", { className: slot.role },
    element("td", { className: "number" }, slot.offset), element("td", { className: "number" }, slot.size),
    element("td", {}, "\u2003".repeat(slot.depth) + slot.path.split(".").pop()), element("td", {}, slot.ros), element("td", {}, slot.iec))));
  if (message) {
    const [folder, name] = message.type.split("/");
    const path = `st/${folder}/ST_${folder}_${name}.st`;
    if (path in result.files) find("file").value = path;
  }
  showFile();
}

const KEYWORDS = "ARRAY|CASE|CONSTANT|DO|ELSE|ELSIF|END_\\w+|EXTENDS|FALSE|FOR|FUNCTION|FUNCTION_BLOCK|IF|METHOD|NOT|AND|OR|XOR|MOD|OF|PROGRAM|REPEAT|RETURN|STRUCT|THEN|TO|TRUE|TYPE|UNTIL|VAR\\w*|WHILE|AT|BY|EXIT";
const TYPES = "BOOL|BYTE|D?WORD|LWORD|U?[SDL]?INT|L?REAL|W?STRING|L?TIME|POINTER|REFERENCE|(?:ST|FB|GVL|E|PRG)_\\w+";
const TOKENS = new RegExp(`(?<comment>\\(\\*[^]*?\\*\\)|//.*|\\{.*?\\})|(?<string>'(?:\\$.|[^'$])*'|"(?:\\$.|[^"$])*")|(?<value>\\b(?:L?T)?#?\\d[\\w#.]*)|(?<keyword>\\b(?:${KEYWORDS})\\b)|(?<type>\\b(?:${TYPES})\\b)`, "g");

function showFile() {
  const path = find("file").value, text = result.files[path] ?? "", parts = [];
  let end = 0;
  for (const match of path.endsWith(".st") ? text.matchAll(TOKENS) : []) {
    const [kind] = Object.entries(match.groups).find(([, value]) => value !== undefined);
    parts.push(text.slice(end, match.index), element("span", { className: kind }, match[0]));
    end = match.index + match[0].length;
  }
  find("text").replaceChildren(...parts, text.slice(end));
}

function save(name, content, type) {
  const address = URL.createObjectURL(new Blob([content], { type }));
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

// ---- a link that holds the input, and what a former visit left ----
async function squeezed(text, Stream) {
  return new Uint8Array(await new Response(new Blob([text]).stream().pipeThrough(new Stream("deflate-raw"))).arrayBuffer());
}

async function link() {
  const bytes = await squeezed(JSON.stringify(state), CompressionStream);
  const code = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")).replace(/[+/=]/g, (sign) => ({ "+": "-", "/": "_", "=": "" })[sign]);
  history.replaceState(null, "", `#${code}`);
  return location.href;
}

async function restore() {
  try {
    if (location.hash.length > 1) {
      const code = atob(location.hash.slice(1).replace(/[-_]/g, (sign) => ({ "-": "+", _: "/" })[sign]));
      const bytes = await squeezed(Uint8Array.from(code, (sign) => sign.charCodeAt(0)), DecompressionStream);
      state = { ...structuredClone(EMPTY), ...JSON.parse(new TextDecoder().decode(bytes)) };
    } else {
      state = { ...structuredClone(EMPTY), ...JSON.parse(localStorage.getItem("shmgen") ?? "{}") };
    }
  } catch {
    setStatus("This link is damaged; the page starts empty.");
  }
  edit(Object.keys(state.files).find((path) => !path.endsWith(".xml")) ?? "");
  await setSource(state.source);
}

async function setSource(source) {
  state.source = source;
  find("types").replaceChildren(...(await ask("types", source)).map((value) => element("option", { value })));
  await generate();
}

// ---- small things ----
function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function setStatus(text) {
  find("status").textContent = text;
}

async function copy(text, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    return setStatus("The browser does not allow copying here. The link is in the address bar.");
  }
  const label = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = label; }, 1500);
}

find("choose").onsubmit = (event) => {
  event.preventDefault();
  const name = find("search").value.trim().replace("/msg/", "/");
  if (!name || state.messages.includes(name)) return;
  state.messages.push(name);
  find("search").value = "";
  changed();
};
find("new-file").onsubmit = (event) => {
  event.preventDefault();
  const path = find("path").value.trim();
  state.files[path] ??= "";
  find("path").value = "";
  edit(path);
  find("editor").focus();
  changed();
};
find("editor").oninput = ({ target }) => { state.files[current] = target.value; changed(); };
find("open").onchange = ({ target }) => openFiles([...target.files]).then(() => { target.value = ""; });
find("bounds").onsubmit = (event) => event.preventDefault();
find("source").onchange = ({ target }) => setSource(target.value);
find("message").onchange = showMessage;
find("file").onchange = showFile;
find("add-topic").onclick = () => {
  const [type] = typesOfTopics();
  if (!type) return setStatus("Choose a message first: a topic carries messages of one type.");
  state.topics.push({ topic: `/topic${state.topics.length + 1}`, type, direction: "to_plc", depth: 1 });
  showTopics();
  changed();
};
find("xml").onclick = () => save("shmgen.xml", result.files["plcopen/shmgen.xml"], "application/xml");
find("zip").onclick = async () => save("shmgen.zip", await ask("zipped", state, result.files), "application/zip");
find("copy-toml").onclick = ({ target }) => copy(result.toml, target);
find("link").onclick = async ({ target }) => copy(await link(), target);
find("editor").ondragover = find("try").ondragover = (event) => { event.preventDefault(); find("editor").classList.add("drop"); };
find("try").ondragleave = () => find("editor").classList.remove("drop");
find("try").ondrop = (event) => { event.preventDefault(); find("editor").classList.remove("drop"); openFiles([...event.dataTransfer.files]); };

start().catch((error) => setStatus(`The generator cannot start: ${error.message}`));
