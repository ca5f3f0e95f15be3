/* An Arduino Uno in simavr, paced at 16 MHz of real time: firmware in, pseudo-terminal and stepper drivers out.
 *
 * uno FIRMWARE LINK STATE
 *
 * LINK becomes a symbolic link to the pseudo-terminal. STATE is a file that holds `struct state`, mapped by whoever started this.
 * Orders come as lines on standard input, whose end ends this program. One thread, so nothing here can race.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define HZ 16000000.0
#define SLICE 0.001  /* s, between two looks at the world */
#define STALL 0.020  /* s; a machine that was away for longer is not caught up with: the motors would run away in a burst */
#define EDGES 131072
#define MAGIC 0x31554E4F

enum { TURN_STEP, TURN_DIR, STEER_STEP, STEER_DIR, DRIVERS };

struct edge {
    uint64_t cycle;
    double time; /* CLOCK_MONOTONIC, s */
    uint32_t pin, level;
};

struct state { /* mirrored in sim/twin/unostate.py */
    uint32_t magic, resets;
    int64_t steps[2];
    uint32_t enabled, lamp; /* lamp: bit 0 near, bit 1 away */
    uint64_t cycles, edges, done, taken; /* done: orders carried out; taken: lines spoiled */
    struct edge ring[EDGES];
};

static avr_t *avr;
static volatile struct state *state;
static double origin; /* when cycle 0 was */
static int master = -1, paced = 1;
static const char *link_path;
static int turn_dir, steer_dir, xon = 1;
static uint8_t in[65536], out[65536];
static size_t in_from, in_to, out_size;
static void (*core_reset)(avr_t *);

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void note(uint32_t pin, uint32_t level)
{
    volatile struct edge *e = &state->ring[state->edges % EDGES];
    e->cycle = avr->cycle;
    e->time = origin + avr->cycle / HZ;
    e->pin = pin;
    e->level = level;
    __sync_synchronize();
    state->edges++;
}

/* ENABLE is PD4, low = on; a pin that is no output is pulled up. */
static void look_at_enable(void)
{
    uint32_t on = (avr->data[0x2A] & 0x10) && !(avr->data[0x2B] & 0x10);
    if (on != state->enabled) {
        state->enabled = on;
        note(DRIVERS, on);
    }
    state->lamp = (avr->data[0x27] & avr->data[0x28]) >> 2 & 3;
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param)
{
    uint32_t pin = (uint32_t)(uintptr_t)param;
    (void)irq;
    look_at_enable();
    note(pin, value);
    if (pin == TURN_DIR)
        turn_dir = value;
    else if (pin == STEER_DIR)
        steer_dir = value;
    else if (value && state->enabled) /* a driver that is off makes nothing of a step */
        state->steps[pin == STEER_STEP] += (pin == STEER_STEP ? steer_dir : turn_dir) ? -1 : 1;
}

static void on_xon(struct avr_irq_t *irq, uint32_t value, void *param) { (void)irq, (void)value, (void)param, xon = 1; }
static void on_xoff(struct avr_irq_t *irq, uint32_t value, void *param) { (void)irq, (void)value, (void)param, xon = 0; }
static void no_sleep(avr_t *a, avr_cycle_count_t c) { (void)a, (void)c; }
static int switches[2], was_reset = 1; /* a reset of simavr forgets what is at the pins */
static void on_reset(avr_t *a)
{
    state->resets++;
    was_reset = 1;
    core_reset(a);
}

/* ---- Faults of the line: the next lines are spoiled, in turn one to the board and one from it. */
static long garble, truncate_;
static int from_board_next;
static struct spoiled { int at, active; } spoil[2];

static int pass(int from_board, uint8_t *byte) /* whether the byte arrives */
{
    struct spoiled *s = &spoil[from_board];
    if (s->at == 0 && *byte != '\n' && (garble || truncate_) && from_board == from_board_next) {
        s->active = garble ? 1 : 2;
        garble -= garble > 0;
        truncate_ -= s->active == 2;
        from_board_next = !from_board_next;
        state->taken++;
    }
    int mode = s->active, at = s->at++;
    if (*byte == '\n')
        s->at = s->active = 0;
    if (mode == 1 && at == 3)
        *byte ^= 0x04;
    return mode != 2 || at < 4;
}

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param)
{
    uint8_t byte = value;
    (void)irq, (void)param;
    if (pass(1, &byte) && out_size < sizeof out)
        out[out_size++] = byte;
}

/* ---- Pseudo-terminal */
static void plug(void)
{
    int slave;
    char name[128], temporary[4096];
    struct termios raw;
    if (master >= 0)
        return;
    if (openpty(&master, &slave, name, NULL, NULL))
        perror("openpty"), exit(1);
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    close(slave);
    snprintf(temporary, sizeof temporary, "%s.%d", link_path, getpid());
    unlink(temporary);
    if (symlink(name, temporary) || rename(temporary, link_path))
        perror(link_path), exit(1);
}

static void unplug(void)
{
    if (master < 0)
        return;
    unlink(link_path);
    close(master);
    master = -1;
    in_from = in_to = out_size = 0;
}

static void serve_line(avr_irq_t *to_board)
{
    if (master >= 0 && in_from == in_to) {
        ssize_t n = read(master, in, sizeof in); /* EIO while nobody has the port open */
        in_from = 0, in_to = n > 0 ? n : 0;
    }
    while (xon && in_from < in_to) {
        uint8_t byte = in[in_from++];
        if (pass(0, &byte))
            avr_raise_irq(to_board, byte);
    }
    if (out_size && master >= 0) {
        ssize_t n = write(master, out, out_size);
        if (n < 0 && errno == EAGAIN)
            n = 0;
        if (n >= 0 && (size_t)n < out_size) /* nobody reads: a real line would lose it too */
            n = out_size;
    }
    out_size = 0;
}

/* ---- Orders */
static void hang(void)
{
    while (!avr->sreg[S_I]) /* leave interrupt handlers: it is the main loop that hangs, interrupts go on */
        avr_run(avr);
    avr->flash[0x7FFE] = 0xFF, avr->flash[0x7FFF] = 0xCF; /* rjmp to itself, at the end of the flash */
    avr->pc = 0x7FFE;
    avr->state = cpu_Running;
}

static void pin(char port, int number, int high)
{
    avr_irq_t *irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), number);
    static avr_ioport_external_t outside; /* without it, a pull-up that is switched on would win over a closed switch */
    outside.name = port;
    outside.mask |= 1 << number;
    outside.value = (outside.value & ~(1 << number)) | high << number;
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &outside);
    avr_raise_irq(irq, !high); /* a level that it believes to be there already is not passed on */
    avr_raise_irq(irq, high);
}

static void set_switches(void)
{
    was_reset = 0;
    pin('C', 0, !switches[0]), pin('C', 1, !switches[1]);
}

static void obey(char *order)
{
    if (sscanf(order, "switches %d %d", &switches[0], &switches[1]) == 2)
        set_switches();
    else if (!strcmp(order, "reset"))
        avr_reset(avr);
    else if (!strcmp(order, "hang"))
        hang();
    else if (!strcmp(order, "unplug"))
        unplug();
    else if (!strcmp(order, "plug"))
        plug();
    else if (!strcmp(order, "mark"))
        state->steps[0] = state->steps[1] = 0;
    else if (!strcmp(order, "free"))
        paced = 0;
    else if (sscanf(order, "garble %ld", &garble) != 1 && sscanf(order, "truncate %ld", &truncate_) != 1)
        fprintf(stderr, "uno: unknown order '%s'\n", order), exit(1);
    state->done++;
}

static void take_orders(void)
{
    static char text[4096];
    static size_t size;
    struct pollfd p = {0, POLLIN, 0};
    while (poll(&p, 1, 0) > 0) {
        ssize_t n = read(0, text + size, sizeof text - 1 - size);
        if (n <= 0) {
            unplug();
            _exit(0);
        }
        text[size += n] = 0;
        char *from = text, *end;
        while ((end = strchr(from, '\n')))
            *end = 0, obey(from), from = end + 1;
        memmove(text, from, size -= from - text);
    }
}

int main(int argc, char **argv)
{
    static elf_firmware_t firmware;
    uint32_t flags = 0;
    if (argc != 4 || elf_read_firmware(argv[1], &firmware))
        return fprintf(stderr, "usage: uno FIRMWARE LINK STATE\n"), 2;
    link_path = argv[2];
    int file = open(argv[3], O_RDWR);
    if (file < 0 || ftruncate(file, sizeof *state))
        return perror(argv[3]), 2;
    state = mmap(NULL, sizeof *state, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->frequency = HZ;
    avr->sleep = no_sleep; /* time is kept below */
    avr_load_firmware(avr, &firmware);
    core_reset = avr->reset;
    avr->reset = on_reset;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_t *uart = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
    avr_irq_register_notify(uart + UART_IRQ_OUTPUT, on_byte, NULL);
    avr_irq_register_notify(uart + UART_IRQ_OUT_XON, on_xon, NULL);
    avr_irq_register_notify(uart + UART_IRQ_OUT_XOFF, on_xoff, NULL);
    static const struct { char port; int pin; } WIRED[] = {{'D', 6}, {'D', 7}, {'B', 0}, {'B', 1}};
    for (uintptr_t i = 0; i < 4; i++)
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(WIRED[i].port), WIRED[i].pin), on_pin, (void *)i);
    plug();
    origin = now();
    state->magic = MAGIC;
    for (;;) {
        take_orders();
        double late = now() - (origin + avr->cycle / HZ);
        if (late > STALL || !paced)
            origin += late - SLICE;
        avr_cycle_count_t until = paced ? (avr_cycle_count_t)((now() - origin) * HZ) : avr->cycle + (avr_cycle_count_t)(SLICE * HZ);
        while (avr->cycle < until) {
            avr_run(avr);
            look_at_enable();
            if (was_reset)
                set_switches();
        }
        if (avr->state == cpu_Done || avr->state == cpu_Crashed)
            return fprintf(stderr, "uno: the processor stopped (state %d)\n", avr->state), unplug(), 1;
        state->cycles = avr->cycle;
        serve_line(uart + UART_IRQ_INPUT);
        if (paced) {
            double rest = origin + avr->cycle / HZ + SLICE - now();
            if (rest > 0)
                usleep((useconds_t)(rest * 1e6));
        }
    }
}
