/* Thermocouple, pyrometer and heater controller on a libmodbus server: thermal_server tcp | rtu PATH.
 *
 * Says its port (tcp) or "ready" (rtu). Registers by number, floats and texts placed by hand: the backend's codec is not
 * used here. Unit 17 has the thermocouple at 0, the pyrometer at 0x100, the heater at 0x200
 * and its identity at 0x1000. The heater trips where nothing is asked for the time of its watchdog.
 */
#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <netinet/in.h>
#include <time.h>
#include <unistd.h>

enum { SIZE = 0x1020, COUPLE = 0, PYROMETER = 0x100, HEATER = 0x200, IDENTITY = 0x1000 };
enum { RUN = HEATER + 22, WATCHDOG = HEATER + 23, RESET = HEATER + 24 };
enum { HEATING = 1, ARMED = 2, SUPPLY = 4 };

static uint16_t *word;

/* IEEE 754 binary32, high word first. libmodbus' own functions of that name mean other orders from version to version,
 * but for modbus_set_float, which has the low word first. */
static void place(int at, float value)
{
    uint32_t raw;
    memcpy(&raw, &value, sizeof raw);
    MODBUS_SET_INT32_TO_INT16(word, at, raw);
}

static float placed(int at)
{
    uint32_t raw = (uint32_t)MODBUS_GET_INT32_FROM_INT16(word, at);
    float value;
    memcpy(&value, &raw, sizeof value);
    return value;
}

static void text(int at, const char *said)
{
    for (size_t i = 0; i < strlen(said); i++)
        word[at + i / 2] |= (uint16_t)((unsigned char)said[i] << (i % 2 ? 0 : 8));
}

static void off(int alarm)
{
    word[RUN] = 0;
    word[HEATER + 5] = alarm;
    place(HEATER + 2, 0.0f);
    word[HEATER + 4] &= ~HEATING;
}

/* What follows from the words that were written. `reset`: whether the reset word was among them. */
static void act(int run, int reset)
{
    word[HEATER + 4] = SUPPLY | (word[HEATER + 4] & HEATING) | (word[WATCHDOG] ? ARMED : 0);
    if (reset)
        word[HEATER + 5] = 0;
    if (run && !word[RUN])
        off(word[HEATER + 5]);
    if (run && word[RUN]) {
        place(HEATER, placed(HEATER + 16));
        place(HEATER + 2, placed(HEATER + 20));
        word[HEATER + 4] |= HEATING;
    }
    word[COUPLE + 3]++;
    word[PYROMETER + 3]++;
}

/* Waits for a request on `bus`, at most as long as an armed watchdog lets; trips it then. */
static int asked(int bus, int listener)
{
    fd_set heard;
    int most = bus > listener ? bus : listener;
    struct timeval left = {word[WATCHDOG] / 1000, word[WATCHDOG] % 1000 * 1000};
    FD_ZERO(&heard);
    if (bus >= 0)
        FD_SET(bus, &heard);
    if (listener >= 0)
        FD_SET(listener, &heard);
    if (select(most + 1, &heard, NULL, NULL, word[HEATER + 4] & HEATING && word[WATCHDOG] ? &left : NULL) == 0) {
        off(1);
        return -1;
    }
    return listener >= 0 && FD_ISSET(listener, &heard) ? listener : bus;
}

int main(int count, char **said)
{
    int tcp = count == 2 && !strcmp(said[1], "tcp");
    modbus_t *bus = tcp ? modbus_new_tcp("127.0.0.1", 0) : count == 3 ? modbus_new_rtu(said[2], 19200, 'N', 8, 1) : NULL;
    modbus_mapping_t *map = modbus_mapping_new(0, 0, SIZE, 0);
    int listener = -1, line = -1;
    uint8_t query[MODBUS_MAX_ADU_LENGTH];

    if (!bus || !map || modbus_set_slave(bus, 17))
        return 2;
    word = map->tab_registers;
    map->tab_input_registers = word; /* both tables are one */
    map->nb_input_registers = SIZE;
    text(IDENTITY, "libmodbus");
    text(IDENTITY + 8, "thermal server");
    text(IDENTITY + 20, "TS-9");
    text(IDENTITY + 28, LIBMODBUS_VERSION_STRING);
    place(COUPLE, 21.25f);
    modbus_set_float(180.5f, &word[PYROMETER]);
    word[PYROMETER + 4] = 950;
    place(HEATER, 20.0f);
    word[HEATER + 4] = SUPPLY;
    if (tcp) {
        struct sockaddr_in at;
        socklen_t size = sizeof at;
        listener = socket(AF_INET, SOCK_STREAM, 0);
        memset(&at, 0, sizeof at);
        at.sin_family = AF_INET;
        at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        if (bind(listener, (struct sockaddr *)&at, size) || listen(listener, 1))
            return 2;
        getsockname(listener, (struct sockaddr *)&at, &size);
        printf("%d\n", ntohs(at.sin_port));
    } else {
        if (modbus_connect(bus))
            return 2;
        line = modbus_get_socket(bus);
        printf("ready\n");
    }
    fflush(stdout);
    for (;;) {
        int ready = asked(line, listener), got, header = modbus_get_header_length(bus);
        if (ready < 0)
            continue;
        if (ready == listener) {
            if (line >= 0)
                modbus_close(bus);
            line = modbus_tcp_accept(bus, &listener);
            continue;
        }
        got = modbus_receive(bus, query);
        if (got > 0) {
            int function = query[header], at = query[header + 1] << 8 | query[header + 2];
            int words = function == MODBUS_FC_WRITE_MULTIPLE_REGISTERS ? query[header + 3] << 8 | query[header + 4] : 0;
            modbus_reply(bus, query, got, map);
            act(at <= RUN && RUN < at + words, at <= RESET && RESET < at + words);
        } else if (got < 0 && tcp) {
            modbus_close(bus);
            line = -1;
        }
    }
}
