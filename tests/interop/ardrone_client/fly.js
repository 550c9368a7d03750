'use strict';
// Flies the drone at HOST with the npm package ar-drone: asks for navdata, watches the video through the package's own PaVE
// parser, takes off, hovers, steers, lands. Prints one JSON object of what it saw. The test judges.
//
// node fly.js <node_modules folder> <host> <at port> <navdata port> <video port> <demo|full> <limit in seconds>

const dgram = require('dgram');
const path = require('path');

const [modules, host, atPort, navdataPort, videoPort, mode, limit] = process.argv.slice(2);
const from = (name) => require(path.join(modules, 'ar-drone', name));
const arDrone = from('index.js');
const TcpVideoStream = from('lib/video/TcpVideoStream.js');
const PaVEParser = from('lib/video/PaVEParser.js');

const report = {
  landed: false,
  controlStates: [],
  navdata: {count: 0, errors: [], ms: 0, full: 0, lostSequence: 0, acks: 0},
  altitude: {max: 0, last: null},
  flyingBit: false,
  tilt: {roll: 0, pitch: 0},
  velocity: {forward: 0},
  battery: null,
  config: [],
  video: {frames: 0, idr: 0, bytes: 0, gaps: 0, badPayload: 0, size: null, codec: null, errors: []},
};

const udpControl = new arDrone.UdpControl({ip: host, port: Number(atPort)});
const udpNavdataStream = new arDrone.UdpNavdataStream({
  ip: host, port: Number(navdataPort), socket: dgram.createSocket('udp4'),
});
const client = new arDrone.Client({udpControl, udpNavdataStream});

const video = new TcpVideoStream({ip: host, port: Number(videoPort)});
const parser = new PaVEParser();
let lastFrame = null;
parser.on('error', (err) => report.video.errors.push(err.message));
parser.on('data', (frame) => {
  const seen = report.video;
  seen.frames += 1;
  seen.idr += frame.frame_type === 1 ? 1 : 0;
  seen.bytes += frame.payload.length;
  seen.size = [frame.display_width, frame.display_height, frame.encoded_stream_width, frame.encoded_stream_height];
  seen.codec = frame.video_codec;
  seen.badPayload += frame.payload.readUInt32BE(0) === 1 ? 0 : 1;
  seen.gaps += lastFrame !== null && frame.frame_number !== lastFrame + 1 ? 1 : 0;
  lastFrame = frame.frame_number;
});
video.on('data', (buffer) => parser.write(buffer));
video.on('error', (err) => report.video.errors.push(err.message));
video.connect((err) => err && report.video.errors.push(err.message));

function finish() {
  process.stdout.write(JSON.stringify(report) + '\n', () => process.exit(0));
}
setTimeout(finish, Number(limit) * 1000);

let lastSequence = null;
let firstAt = null;
client.on('navdata', (navdata) => {
  const seen = report.navdata;
  const now = Date.now();
  firstAt = firstAt || now;
  seen.count += 1;
  seen.ms = now - firstAt;
  seen.acks += navdata.droneState.controlCommandAck;
  seen.lostSequence += lastSequence !== null && navdata.sequenceNumber !== lastSequence + 1 ? 1 : 0;
  lastSequence = navdata.sequenceNumber;
  seen.full += navdata.altitude && navdata.magneto && navdata.physMeasures ? 1 : 0;
  report.flyingBit = report.flyingBit || navdata.droneState.flying === 1;
  if (navdata.demo) {
    const state = navdata.demo.controlState;
    const states = report.controlStates;
    if (states[states.length - 1] !== state) {
      states.push(state);
    }
    report.altitude.max = Math.max(report.altitude.max, navdata.demo.altitude);
    report.altitude.last = navdata.demo.altitude;
    report.battery = navdata.demo.batteryPercentage;
    report.tilt.pitch = Math.min(report.tilt.pitch, navdata.demo.frontBackDegrees);
    report.velocity.forward = Math.max(report.velocity.forward, navdata.demo.xVelocity);
  }
});
client.on('error', (err) => report.navdata.errors.push(err.message));

client.resume();
let unconfigured = 2;
const configured = (key) => (err) => {
  report.config.push([key, err ? err.message : 'acknowledged']);
  unconfigured -= 1;
  if (unconfigured === 0) {
    setTimeout(flight, 300);
  }
};
client.config('general:navdata_demo', mode === 'demo' ? 'TRUE' : 'FALSE', configured('general:navdata_demo'));
client.config('video:video_channel', '1', configured('video:video_channel'));

function flight() {
  client.takeoff(() => {
    client.front(0.5);
    setTimeout(() => client.stop(), 800);
    setTimeout(() => client.land(() => {
      report.landed = true;
      setTimeout(finish, 200);
    }), 1300);
  });
}
