/* Browsers start no workers from files. For pages that are opened as files, this runs a worker's script in a hidden frame. */
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(url) {
      this.onmessage = null;
      this.onerror = null;
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = "<!doctype html>";
      this.frame.onload = () => {
        const inside = this.frame.contentWindow;
        inside.postMessage = (data) => setTimeout(() => this.onmessage && this.onmessage({ data }));
        const script = inside.document.createElement("script");
        script.src = new URL(url, location.href).href;
        script.onload = () => {
          this.deliver = (data) => inside.onmessage({ data });
          this.waiting.splice(0).forEach(this.deliver);
        };
        script.onerror = () => this.onerror && this.onerror(new Event("error"));
        inside.document.body.append(script);
      };
      document.body.append(this.frame);
    }

    postMessage(data) {
      if (this.deliver) setTimeout(() => this.deliver(data));
      else this.waiting.push(data);
    }

    terminate() {
      this.frame.remove();
    }
  };
}
