// A CiA 402 drive on npm canopen: node drive.js PORT NODE. Its library answers SDO, NMT, heartbeat and PDOs; only the
// behaviour of the axis is written here, from the words of CiA 402. Says "ready"; at the end of its standard input it
// says what was written to it, as JSON.
'use strict';

const { Device, DataType, ObjectType } = require('canopen');
const { attach } = require('./slcan');

const MOVES_MS = 300;
const [port, id] = process.argv.slice(2).map(Number);
const device = new Device({ id });
const eds = device.eds;

function variable(index, dataType, value) {
    const entry = eds.getEntry(index) || eds.addEntry(index, { parameterName: `object ${index}`, dataType });
    entry.value = value;
    return entry;
}

function record(index, values) {
    const entry = eds.getEntry(index)
        || eds.addEntry(index, { parameterName: `record ${index}`, objectType: ObjectType.RECORD });
    values.forEach(([dataType, value], at) => {
        const sub = entry.addSubObject(at + 1, { parameterName: `${index} ${at + 1}`, dataType });
        sub.value = value;
    });
    return entry;
}

const { INTEGER8: I8, INTEGER16: I16, INTEGER32: I32, UNSIGNED8: U8, UNSIGNED16: U16, UNSIGNED32: U32 } = DataType;
variable(0x1008, DataType.VISIBLE_STRING, 'A drive on node.js');
variable(0x100A, DataType.VISIBLE_STRING, '6.2.1');
variable(0x1017, U16, 0);
record(0x1016, [[U32, 0]]);
record(0x1018, [[U32, 0x123], [U32, 0x456], [U32, 7], [U32, 4712]]);
record(0x1029, [[U8, 0]]);
for (const index of [0x6007, 0x605A, 0x605E])
    variable(index, I16, 0);
for (const index of [0x6065, 0x6080, 0x6081, 0x6083, 0x6084, 0x6085, 0x609A])
    variable(index, U32, 1);
variable(0x603F, U16, 0);
variable(0x6098, I8, 1);
record(0x607D, [[I32, 0], [I32, 0]]);
record(0x608F, [[U32, 10000], [U32, 1]]);
record(0x6091, [[U32, 1], [U32, 1]]);
record(0x6092, [[U32, 100000], [U32, 1]]);
record(0x6099, [[U32, 1], [U32, 1]]);
record(0x60FE, [[U32, 0]]);
const controlword = variable(0x6040, U16, 0);
const statusword = variable(0x6041, U16, 0);
const mode = variable(0x6060, I8, 1);
const shown = variable(0x6061, I8, 1);
const position = variable(0x6064, I32, 0);
const velocity = variable(0x606C, I32, 0);
const target = variable(0x607A, I32, 0);
for (const index of [0x1400, 0x1401, 0x1800, 0x1801]) {
    const cob = { 0x1400: 0x200, 0x1401: 0x300, 0x1800: 0x180, 0x1801: 0x280 }[index];
    record(index, [[U32, (0x80000000 + cob + id) >>> 0], [U8, 254], [U16, 0], [U8, 0], [U16, 0]]);
    record(index + 0x200, Array.from({ length: 8 }, () => [U32, 0]));
}
eds.addSdoServerParameter(127, 0x580 + id, 0x600 + id);

const axis = { bits: 0x0250, word: 0, acknowledged: false, homed: false, from: 0, to: 0, began: 0, moving: false };
let starts = 0;

function place() {
    const share = axis.moving ? Math.min((Date.now() - axis.began) / MOVES_MS, 1) : 1;
    return Math.round(axis.from + share * (axis.to - axis.from));
}

/** Bring the objects up to date; those mapped to a TPDO go out where a PDO is mapped. */
function show() {
    position.value = place();
    if (axis.moving && Date.now() - axis.began >= MOVES_MS) {
        axis.moving = false;
        if (shown.value === 6)
            axis.homed = axis.acknowledged = true;
    }
    velocity.value = axis.moving ? Math.round((axis.to - axis.from) * 1000 / MOVES_MS) : 0;
    const before = statusword.value;
    statusword.value = axis.bits | (axis.moving ? 0 : 0x400) | (axis.acknowledged ? 0x1000 : 0)
        | (axis.homed ? 0x8000 : 0);
    if (statusword.value !== before && device.pdo.started)
        device.pdo.write(0x180 + id);
}

function control(word) {
    const before = axis.word;
    axis.word = word;
    const state = axis.bits & 0x6F;
    if ((word & 0x0F) === 0x06)
        axis.bits = 0x0231;
    else if ((word & 0x0F) === 0x07)
        axis.bits = 0x0233;
    else if ((word & 0x0F) === 0x0F && [0x23, 0x27, 0x07].includes(state))
        axis.bits = 0x0237;
    else if ((word & 0x06) === 0x02 && state === 0x27) {
        axis.bits = 0x0217;
        axis.from = axis.to = place();
        axis.moving = false;
    }
    if ((axis.bits & 0x6F) !== 0x27)
        return;
    if (word & 0x10 && !(before & 0x10)) {
        const homing = shown.value === 6;
        starts += 1;
        axis.from = place();
        axis.to = homing ? 0 : target.value;
        axis.began = Date.now();
        axis.moving = true;
        axis.acknowledged = !homing;
    }
    else if (!(word & 0x10) && shown.value === 1)
        axis.acknowledged = false;
}

function taken() {
    shown.value = mode.value;
    control(controlword.value);
    show();
}

controlword.addListener('update', taken);
mode.addListener('update', taken);
device.pdo.on('pdo', taken);
show();
const timer = setInterval(show, 10);
device.start();
device.nmt.enterPreOperational();
attach(device, port).then((socket) => {
    console.log('ready');
    process.stdin.resume();
    process.stdin.on('end', () => {
        const said = { starts, position: place(), limits: [eds.getEntry(0x607D)[1].value, eds.getEntry(0x607D)[2].value],
            quickStop: eds.getEntry(0x605A).value, consumer: eds.getEntry(0x1016)[1].value };
        console.log(JSON.stringify(said));
        clearInterval(timer);
        device.stop();
        socket.destroy();
    });
});
