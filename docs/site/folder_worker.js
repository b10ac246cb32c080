// A page that was opened from a folder may not start a worker, and the search is one. There, this
// runs the worker's script in a hidden frame, which is passed messages as a worker is.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    #frame = document.createElement("iframe");
    #waiting = [];

    constructor(url) {
      super();
      this.#frame.hidden = true;
      document.body.append(this.#frame);
      const inside = this.#frame.contentWindow;
      inside.postMessage = (data) => this.#tell(new MessageEvent("message", { data }));
      const script = inside.document.createElement("script");
      script.src = url;
      script.onload = () => {
        const waiting = this.#waiting;
        this.#waiting = null;
        waiting.forEach((data) => this.postMessage(data));
      };
      script.onerror = () => this.#tell(new Event("error"));
      inside.document.body.append(script);
    }

    postMessage(data) {
      if (this.#waiting) {
        this.#waiting.push(data);
        return;
      }
      const inside = this.#frame.contentWindow;
      // Copied into the frame, so that what is an array here is one there.
      const copy = inside.structuredClone(data);
      inside.dispatchEvent(new inside.MessageEvent("message", { data: copy }));
    }

    terminate() {
      this.#frame.remove();
    }

    #tell(event) {
      // Later, as from another thread: a listener may answer at once.
      setTimeout(() => {
        this["on" + event.type]?.(event);
        this.dispatchEvent(event);
      });
    }
  };
}
