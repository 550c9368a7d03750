// Pictures as H.264, decoded by the browser (WebCodecs). Where it cannot, the service goes on with JPEG.
const ANY = "avc1.42c01f";
const FAULTS_MAX = 3;

export class VideoPictures {
  #taken;
  #ask;
  #decoder = null;
  #codec = "";
  #waiting = new Map();
  #faults = 0;

  // taken(header, frame) gets each decoded picture; ask(codec) tells the service what to send from now on.
  constructor(taken, ask) {
    this.#taken = taken;
    this.#ask = ask;
  }

  async begin(offered) {
    this.#drop();
    this.#faults = 0;
    // Browsers offer decoders to secure pages alone: by TLS or on loopback.
    if (!offered || !("VideoDecoder" in globalThis)) return;
    const known = await VideoDecoder.isConfigSupported({ codec: ANY, optimizeForLatency: true }).catch(() => null);
    if (known?.supported) this.#ask("h264");
  }

  decode(header, image) {
    const key = header.codec !== "";
    try {
      if (key && (this.#decoder === null || this.#codec !== header.codec)) this.#configure(header.codec);
      if (this.#decoder === null) return;
      this.#waiting.set(header.number, header);
      this.#decoder.decode(new EncodedVideoChunk({ type: key ? "key" : "delta", timestamp: header.number, data: image }));
    } catch {
      this.#failed();
    }
  }

  #configure(codec) {
    this.#drop();
    this.#codec = codec;
    this.#decoder = new VideoDecoder({
      output: (frame) => {
        const header = this.#waiting.get(frame.timestamp);
        this.#waiting.delete(frame.timestamp);
        if (header === undefined) frame.close();
        else this.#taken(header, frame);
      },
      error: () => this.#failed(),
    });
    this.#decoder.configure({ codec, optimizeForLatency: true });
  }

  // A decoder that fails is not mended: the service begins again with a key frame, and after some times with JPEG.
  #failed() {
    this.#drop();
    this.#faults += 1;
    this.#ask(this.#faults < FAULTS_MAX ? "h264" : "jpeg");
  }

  #drop() {
    if (this.#decoder !== null && this.#decoder.state !== "closed") this.#decoder.close();
    this.#decoder = null;
    this.#waiting.clear();
  }
}
