// A session of npm canopen as master with a drive: node master.js PORT NODE. Fails with what is not as it should be.
'use strict';

const assert = require('assert');
const { Device, DataType, NmtState } = require('canopen');
const { attach } = require('./slcan');

const [port, id] = process.argv.slice(2).map(Number);
const { INTEGER32: I32, UNSIGNED16: U16, UNSIGNED32: U32, UNSIGNED8: U8, VISIBLE_STRING } = DataType;
const device = new Device({ id: 126 });

const read = (index, subIndex, dataType) =>
    device.sdo.upload({ deviceId: id, index, subIndex, dataType, timeout: 5000 });
const write = (index, subIndex, dataType, data) =>
    device.sdo.download({ deviceId: id, index, subIndex, dataType, data, timeout: 5000 });

/** Resolves with the event's value once `wanted` of it is true. */
function heard(emitter, event, wanted) {
    return new Promise((resolve, reject) => {
        const late = setTimeout(() => reject(new Error(`no ${event} that was waited for`)), 5000);
        emitter.on(event, (value) => {
            if (wanted(value)) {
                clearTimeout(late);
                resolve(value);
            }
        });
    });
}

async function session() {
    assert.strictEqual(await read(0x1000, 0, U32), 0x00020192);
    assert.strictEqual(await read(0x1008, 0, VISIBLE_STRING), 'servo drive');
    await assert.rejects(read(0x5FFF, 0, U32), /0x6020000|does not exist/i);
    await assert.rejects(write(0x6040, 0, U32, 0), /0x6070010|length/i);

    const preOperational = heard(device.nmt, 'heartbeat',
        ({ deviceId, state }) => deviceId === id && state === NmtState.PRE_OPERATIONAL);
    await write(0x1017, 0, U16, 20);
    await preOperational;

    // The status by PDO, mapped anew: off, none, the object, one, on change, on.
    await write(0x1800, 1, U32, 0x80000180 + id);
    await write(0x1A00, 0, U8, 0);
    await write(0x1A00, 1, U32, 0x60410010);
    await write(0x1A00, 0, U8, 1);
    await write(0x1800, 2, U8, 255);
    await write(0x1800, 1, U32, 0x180 + id);
    const operational = heard(device.nmt, 'heartbeat',
        ({ deviceId, state }) => deviceId === id && state === NmtState.OPERATIONAL);
    device.nmt.startNode(id);
    device.nmt.startNode();
    await operational;

    await write(0x6083, 0, U32, 1000000);
    await write(0x6085, 0, U32, 1000000);
    await write(0x607A, 0, I32, 10000);
    await write(0x6081, 0, U32, 100000);
    await write(0x6040, 0, U16, 0x0F);
    await write(0x6040, 0, U16, 0x1F);
    assert.strictEqual(await read(0x6041, 0, U16) & 0x1400, 0x1000);
    const arrived = heard(device.pdo, 'pdo', () => (device.eds.getEntry(0x2000).value & 0x1400) === 0x0400);
    await write(0x6040, 0, U16, 0x0F);
    await arrived;
    assert.strictEqual(await read(0x6064, 0, I32), 10000);
    await write(0x6040, 0, U16, 0x02);
    assert.strictEqual(await read(0x6041, 0, U16) & 0x6F, 0x07);
}

device.eds.addSdoClientParameter(id, 0x600 + id, 0x580 + id);
device.eds.addHeartbeatConsumer(id, 500);
const status = device.eds.addEntry(0x2000, { parameterName: 'status of the drive', dataType: U16 });
device.eds.addReceivePdo({ cobId: 0x180 + id, dataObjects: [status] });
device.start();
device.nmt.enterPreOperational();
attach(device, port).then(async (socket) => {
    await session();
    console.log('obeyed');
    device.stop();
    socket.destroy();
}).catch((error) => {
    console.error(error);
    process.exit(1);
});
