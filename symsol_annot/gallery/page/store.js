// Data comes as scripts, for a page from disk cannot fetch: each calls SYMSOL.deliver(key, document).
"use strict";

SYMSOL.store = (() => {
  const KEPT = 40; // documents; the least recently asked for go first
  const delivered = new Map();
  const waiting = new Map();
  const TYPES = { u1: Uint8Array, i2: Int16Array, u4: Uint32Array, f4: Float32Array };

  SYMSOL.deliver = (key, document) => delivered.set(key, document);

  function request(key, file = `${key}.js`) {
    if (delivered.has(key)) {
      const document = delivered.get(key);
      delivered.delete(key);
      delivered.set(key, document);
      return Promise.resolve(document);
    }
    if (!waiting.has(key)) {
      const loading = load(file).then(() => {
        if (!delivered.has(key)) throw new Error(`${file} is damaged`);
        for (const old of [...delivered.keys()].slice(0, Math.max(0, delivered.size - KEPT))) delivered.delete(old);
        return delivered.get(key);
      });
      waiting.set(key, loading);
      loading.catch(() => {}).finally(() => waiting.delete(key));
    }
    return waiting.get(key);
  }

  function load(file) {
    return new Promise((resolve, reject) => {
      const script = document.createElement("script");
      script.src = file;
      script.onload = () => { script.remove(); resolve(); };
      script.onerror = () => { script.remove(); reject(new Error(`${file} cannot be loaded`)); };
      document.head.append(script);
    });
  }

  // An array as `packed` in scripts.py has it.
  function unpacked(value) {
    const text = atob(value.data);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new TYPES[value.dtype](bytes.buffer);
  }

  return { request, load, unpacked };
})();
