// Runs Python, and shmgen in it, beside the page. Each message { id, call, args } is answered with { id, result } or { id, error }.
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
  types: (source) => plain(generator.stored_types(source)),
  run: (state) => plain(generator.run(python.toPy(state))),
  zipped: (state, files) => plain(generator.zipped(python.toPy(state), python.toPy(files))),
  unzipped: (name, content) => plain(generator.unzipped(name, python.toPy(content).tobytes())),
};

function plain(value) {
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
