// Runs Python with shmgen in a thread of its own, so that the page stays responsive. Answers each message { id, call, args } with
// { id, result } or { id, error }.
let python, generator;

const calls = {
  async start(folder) {
    const { loadPyodide } = await import(folder + "pyodide.mjs");
    const [instance, packages] = await Promise.all([
      loadPyodide({ indexURL: folder }),
      fetch(folder + "packages.zip").then((response) => response.arrayBuffer()),
    ]);
    python = instance;
    python.unpackArchive(packages, "zip", { extractDir: "/packages" });
    python.runPython("import sys; sys.path.insert(0, '/packages')");
    generator = python.pyimport("generator");
    generator.load_stores("/packages/stores");
  },
  types: (source) => toJavaScript(generator.stored_types(source)),
  run: (state) => toJavaScript(generator.run(python.toPy(state))),
  packZip: (state, files) => toJavaScript(generator.pack_zip(python.toPy(state), python.toPy(files))),
  unpackZip: (name, content) => toJavaScript(generator.unpack_zip(name, python.toPy(content).tobytes())),
};

// Convert a result of Python, and free its memory.
function toJavaScript(value) {
  const result = value.toJs({ dict_converter: Object.fromEntries });
  value.destroy();
  return result;
}

onmessage = async ({ data: { id, call, args } }) => {
  try {
    postMessage({ id, result: await calls[call](...args) });
  } catch (error) {
    postMessage({ id, error: String(error) });
  }
};
