/* Browsers start no worker for a page from a disk (file:), so there the site's search runs in a hidden frame.
   A frame has what the search asks of a worker: messages to it, messages from it, and scripts that it imports. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.title = "search";
      document.body.append(frame);
      const inside = frame.contentWindow;
      const load = (each) => new Promise((resolve) => {
        const script = inside.document.createElement("script");
        script.src = each;
        script.onload = resolve;
        inside.document.body.append(script);
      });
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inside.importScripts = (...urls) => urls.reduce((before, each) => before.then(() => load(each)), Promise.resolve());
      this.started = load(url).then(() => inside);
    }

    postMessage(data) {
      this.started.then((inside) => inside.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
