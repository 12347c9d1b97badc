// A CANopen device of npm canopen on a CAN hub over TCP, in LAWICEL ASCII lines.
'use strict';

const net = require('net');

/** Connect `device` to the hub; resolves once the channel is open. */
function attach(device, port) {
    return new Promise((resolve, reject) => {
        const socket = net.connect(port, '127.0.0.1');
        let rest = '';
        socket.setNoDelay(true);
        socket.on('error', reject);
        socket.on('connect', () => {
            socket.write('C\rS8\rO\r');
            resolve(socket);
        });
        socket.on('data', (chunk) => {
            const lines = (rest + chunk.toString('latin1')).split(/[\r\x07]/);
            rest = lines.pop();
            for (const line of lines) {
                if (line[0] !== 't')
                    continue; // answers to our own lines
                const data = Buffer.from(line.slice(5), 'hex');
                device.receive({ id: parseInt(line.slice(1, 4), 16), data, len: data.length });
            }
        });
        device.addListener('message', ({ id, data }) => {
            const head = 't' + id.toString(16).padStart(3, '0') + data.length;
            socket.write(head + Buffer.from(data).toString('hex') + '\r');
        });
    });
}

module.exports = { attach };
