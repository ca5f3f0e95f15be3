/* smolbot's magnet stage: an Arduino Uno (ATmega328P, 16 MHz) that turns a magnet and steers the axis it turns about.
 *
 * Plain avr-libc with its own main, so that both the Arduino IDE and avr-gcc build it. Wiring and protocol: docs/magnet-stage.md.
 * A magnet must never run away: nothing moves before ARM, ARM needs a heartbeat, a hung main loop is reset by the hardware
 * watchdog, a reset lets every pin float, and the pull-up at the drivers' ENABLE then means off.
 */
#ifndef F_CPU
#define F_CPU 16000000UL
#endif
#define BAUD 115200UL

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdint.h>
#include <string.h>
#include <util/atomic.h>
#include <util/crc16.h>
#include <util/delay.h>

#define NAME "smolbot-magnet-stage 1.0"

/* Limits of what a line may ask. Change them to suit the motors, never the checks. */
#define RATE_MIN 40UL         /* steps/s; ramps begin here, and a slower step would not fit the 16-bit timer */
#define RATE_MAX 4000UL       /* steps/s */
#define STEPS_MAX 1000000UL   /* in one command */
#define ACCELERATION 2000UL   /* steps/s^2 */
#define HEARTBEAT_MS 500      /* without BEAT: lamps out, and while armed fault, motors off */
#define WATCHDOG WDTO_120MS   /* its oscillator is off by up to a fifth: still off within 0.25 s */
#define DEBOUNCE_MS 10

/* Pins. Not PD2 and PD3: they are left for external interrupts. */
#define TURN_STEP _BV(PD6)    /* D6 */
#define TURN_DIR _BV(PD7)     /* D7 */
#define ENABLE _BV(PD4)       /* D4, low = on; 10 kOhm to 5 V at the drivers */
#define STEER_STEP _BV(PB0)   /* D8 */
#define STEER_DIR _BV(PB1)    /* D9 */
#define LED _BV(PB5)          /* D13: armed */
#define NEAR_SWITCH _BV(PC0)  /* A0, to ground when the magnet is there */
#define AWAY_SWITCH _BV(PC1)  /* A1 */
#define NEAR_LAMP _BV(PC2)    /* A2, high = asks the operator to bring the magnet near */
#define AWAY_LAMP _BV(PC3)    /* A3 */

#define TIMER_HZ (F_CPU / 8)

typedef struct {
    volatile uint32_t left;     /* steps to go */
    volatile int32_t place;     /* steps since boot */
    volatile uint16_t interval; /* timer ticks between two steps */
    volatile int8_t direction;
    uint16_t rate, cruise;      /* steps/s, now and wanted */
} axis_t;

enum { FAULT_NONE, FAULT_HEARTBEAT, FAULT_WATCHDOG };
static const char *const FAULTS[] = {"NONE", "HEARTBEAT", "WATCHDOG"};

static axis_t turn, steer;
static volatile uint8_t ticks;
static uint8_t armed, fault, switches;
static uint16_t silence; /* ms since the last BEAT */
static uint8_t cause __attribute__((section(".noinit")));

/* ---- Reset: a watchdog that fired stays on and would fire again before main; the bootloader may have cleared the cause. */
void at_reset(void) __attribute__((naked, used, section(".init3")));
void at_reset(void)
{
    cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

/* ---- Serial line: rings filled and emptied by interrupts. A reply that finds no room is dropped, never waited for. */
#define RX_SIZE 128
#define TX_SIZE 128
static volatile uint8_t rx[RX_SIZE], rx_in, rx_out, tx[TX_SIZE], tx_in, tx_out, rx_lost;

ISR(USART_RX_vect)
{
    uint8_t broken = UCSR0A & (_BV(FE0) | _BV(DOR0)), byte = UDR0, next = (uint8_t)(rx_in + 1) % RX_SIZE;
    if (broken || next == rx_out) {
        rx_lost = 1;
        return;
    }
    rx[rx_in] = byte;
    rx_in = next;
}

ISR(USART_UDRE_vect)
{
    if (tx_in == tx_out) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = tx[tx_out];
    tx_out = (uint8_t)(tx_out + 1) % TX_SIZE;
}

static void send(const char *text, uint8_t size)
{
    uint8_t room = (uint8_t)(tx_out - tx_in - 1) % TX_SIZE;
    if (size > room)
        return;
    for (uint8_t i = 0; i < size; i++) {
        tx[tx_in] = (uint8_t)text[i];
        tx_in = (uint8_t)(tx_in + 1) % TX_SIZE;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { UCSR0B |= _BV(UDRIE0); }
}

/* ---- Replies: built in one buffer, which is kept so that a repeated line gets the same answer and moves nothing twice. */
#define REPLY_SIZE 72
static char reply[REPLY_SIZE];
static uint8_t reply_size;

static void put(const char *text)
{
    while (*text && reply_size < REPLY_SIZE - 7)
        reply[reply_size++] = *text++;
}

static void put_number(int32_t value)
{
    char digits[12], *at = digits + sizeof digits - 1;
    uint32_t rest = value < 0 ? 0UL - (uint32_t)value : (uint32_t)value;
    *at = 0;
    do {
        *--at = (char)('0' + rest % 10);
        rest /= 10;
    } while (rest);
    if (value < 0)
        *--at = '-';
    put(at);
}

static uint16_t checksum(const char *text, uint8_t size)
{
    uint16_t crc = 0xFFFF;
    while (size--)
        crc = _crc_xmodem_update(crc, (uint8_t)*text++);
    return crc;
}

static void seal_and_send(void)
{
    static const char HEX[] = "0123456789ABCDEF";
    uint16_t crc = checksum(reply, reply_size);
    reply[reply_size++] = '*';
    for (int8_t shift = 12; shift >= 0; shift -= 4)
        reply[reply_size++] = HEX[(crc >> shift) & 15];
    reply[reply_size++] = '\n';
    send(reply, reply_size);
}

static void not_understood(const char *why)
{
    /* In a buffer of its own would cost RAM; instead the kept answer is given up, and with it the right to repeat it. */
    reply_size = 0;
    put("? NAK ");
    put(why);
    seal_and_send();
}

/* ---- Motors */
ISR(TIMER1_COMPA_vect)
{
    OCR1A += turn.interval;
    PORTD |= TURN_STEP;
    turn.place += turn.direction;
    if (--turn.left == 0)
        TIMSK1 &= (uint8_t)~_BV(OCIE1A);
    _delay_us(2);
    PORTD &= (uint8_t)~TURN_STEP;
}

ISR(TIMER1_COMPB_vect)
{
    OCR1B += steer.interval;
    PORTB |= STEER_STEP;
    steer.place += steer.direction;
    if (--steer.left == 0)
        TIMSK1 &= (uint8_t)~_BV(OCIE1B);
    _delay_us(2);
    PORTB &= (uint8_t)~STEER_STEP;
}

ISR(TIMER2_COMPA_vect) { ticks++; }

static void motors_off(void)
{
    PORTD |= ENABLE;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        TIMSK1 = 0;
        turn.left = steer.left = 0;
    }
    armed = 0;
    PORTB &= (uint8_t)~LED;
}

static void set_lamps(uint8_t lit) { PORTC = (uint8_t)((PORTC & ~(NEAR_LAMP | AWAY_LAMP)) | lit); }

static uint32_t left_of(const axis_t *axis)
{
    uint32_t left;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { left = axis->left; }
    return left;
}

static int32_t place_of(const axis_t *axis)
{
    int32_t place;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { place = axis->place; }
    return place;
}

/* Every millisecond: faster up to the cruising rate, slower in time to end at the starting rate. */
static void ramp(axis_t *axis)
{
    uint32_t left = left_of(axis);
    uint16_t rate = axis->rate;
    if (!left)
        return;
    if (left <= (uint32_t)rate * rate / (2 * ACCELERATION))
        rate = rate > RATE_MIN + ACCELERATION / 1000 ? rate - ACCELERATION / 1000 : RATE_MIN;
    else if (rate < axis->cruise)
        rate = axis->cruise - rate > ACCELERATION / 1000 ? rate + ACCELERATION / 1000 : axis->cruise;
    if (rate == axis->rate)
        return;
    axis->rate = rate;
    uint16_t interval = (uint16_t)(TIMER_HZ / rate);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { axis->interval = interval; }
}

static void prepare(axis_t *axis, int32_t steps, uint16_t cruise)
{
    axis->direction = steps < 0 ? -1 : 1;
    axis->cruise = cruise;
    axis->rate = RATE_MIN;
    axis->interval = (uint16_t)(TIMER_HZ / RATE_MIN);
    axis->left = steps < 0 ? 0UL - (uint32_t)steps : (uint32_t)steps;
}

/* Both axes start in the same instant. They are at rest, so no interrupt looks at what is written here. */
static void move(int32_t turn_steps, uint16_t turn_rate, int32_t steer_steps, uint16_t steer_rate)
{
    prepare(&turn, turn_steps, turn_rate);
    prepare(&steer, steer_steps, steer_rate);
    if (turn_steps < 0)
        PORTD |= TURN_DIR;
    else
        PORTD &= (uint8_t)~TURN_DIR;
    if (steer_steps < 0)
        PORTB |= STEER_DIR;
    else
        PORTB &= (uint8_t)~STEER_DIR;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        OCR1A = TCNT1 + turn.interval;
        OCR1B = TCNT1 + steer.interval;
        TIFR1 = _BV(OCF1A) | _BV(OCF1B);
        TIMSK1 = (uint8_t)((turn_steps ? _BV(OCIE1A) : 0) | (steer_steps ? _BV(OCIE1B) : 0));
    }
}

/* ---- Commands. Each answers with "OK ..." or "ERR reason". */
#define WORDS_MAX 5
static char *words[WORDS_MAX];
static uint8_t count;

/* A whole decimal number of at most seven digits; anything else is refused. */
static uint8_t number(const char *text, int32_t *value)
{
    uint8_t negative = *text == '-', digits = 0;
    int32_t sum = 0;
    for (text += negative; *text; text++) {
        if (*text < '0' || *text > '9' || ++digits > 7)
            return 0;
        sum = sum * 10 + (*text - '0');
    }
    *value = negative ? -sum : sum;
    return digits > 0;
}

static uint8_t rate_allowed(int32_t steps, int32_t rate)
{
    return steps ? rate >= (int32_t)RATE_MIN && rate <= (int32_t)RATE_MAX : rate >= 0 && rate <= (int32_t)RATE_MAX;
}

static const char *do_move(void)
{
    int32_t asked[4];
    if (count != 5)
        return "ARGUMENTS";
    for (uint8_t i = 0; i < 4; i++)
        if (!number(words[i + 1], &asked[i]))
            return "ARGUMENTS";
    for (uint8_t i = 0; i < 4; i += 2) {
        if (asked[i] > (int32_t)STEPS_MAX || asked[i] < -(int32_t)STEPS_MAX)
            return "STEPS";
        if (!rate_allowed(asked[i], asked[i + 1]))
            return "RATE";
    }
    if (fault)
        return "FAULT";
    if (!armed)
        return "DISARMED";
    if (left_of(&turn) || left_of(&steer))
        return "BUSY";
    move(asked[0], (uint16_t)asked[1], asked[2], (uint16_t)asked[3]);
    return 0;
}

static const char *do_arm(void)
{
    if (count != 1)
        return "ARGUMENTS";
    if (fault)
        return "FAULT";
    if (silence >= HEARTBEAT_MS)
        return "HEARTBEAT";
    armed = 1;
    PORTD &= (uint8_t)~ENABLE;
    PORTB |= LED;
    return 0;
}

static const char *do_lamp(void)
{
    uint8_t lit;
    if (count != 2)
        return "ARGUMENTS";
    if (!strcmp(words[1], "NEAR"))
        lit = NEAR_LAMP;
    else if (!strcmp(words[1], "AWAY"))
        lit = AWAY_LAMP;
    else if (!strcmp(words[1], "NONE"))
        lit = 0;
    else
        return "ARGUMENTS";
    if (lit && silence >= HEARTBEAT_MS)
        return "HEARTBEAT";
    set_lamps(lit);
    return 0;
}

static void put_state(void)
{
    static const char *const SWITCHES[] = {" NONE ", " NEAR ", " AWAY ", " BOTH "};
    put(armed ? " ARMED " : " OFF ");
    put(left_of(&turn) || left_of(&steer) ? "MOVING" : "IDLE");
    put(SWITCHES[switches]);
    put(FAULTS[fault]);
    put(" ");
    put_number(place_of(&turn));
    put(" ");
    put_number(place_of(&steer));
}

static void execute(void)
{
    const char *verb = words[0], *error = 0;
    uint8_t size = reply_size; /* "SEQ" stands there already */
    put(" OK");
    if (!strcmp(verb, "MOVE"))
        error = do_move();
    else if (!strcmp(verb, "ARM"))
        error = do_arm();
    else if (!strcmp(verb, "LAMP"))
        error = do_lamp();
    else if (count != 1)
        error = "ARGUMENTS";
    else if (!strcmp(verb, "BEAT")) {
        silence = 0;
        put_state();
    } else if (!strcmp(verb, "ID")) {
        put(" ");
        put(NAME);
    } else if (!strcmp(verb, "OFF"))
        motors_off();
    else if (!strcmp(verb, "CLEAR"))
        fault = FAULT_NONE;
    else
        error = "COMMAND";
    if (error) {
        reply_size = size;
        put(" ERR ");
        put(error);
    }
    seal_and_send();
}

/* ---- Lines: "SEQ VERB ARGUMENTS*CRC", where CRC is of all before the star. */
#define LINE_SIZE 64
static char line[LINE_SIZE + 1];
static uint8_t line_size, line_bad;
static int16_t last_sequence = -1;
static uint16_t last_crc;

static int8_t hex(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

static void forget_last(const char *why)
{
    last_sequence = -1;
    not_understood(why);
}

static void take_line(void)
{
    uint16_t crc = 0;
    uint8_t body = line_size - 5;
    int32_t sequence;
    if (line_size < 6 || line[body] != '*') {
        forget_last("FORM");
        return;
    }
    for (uint8_t i = body + 1; i < line_size; i++) {
        int8_t digit = hex(line[i]);
        if (digit < 0) {
            forget_last("FORM");
            return;
        }
        crc = (uint16_t)(crc << 4 | digit);
    }
    if (crc != checksum(line, body)) {
        forget_last("CHECKSUM");
        return;
    }
    line[body] = 0;
    char *at = strchr(line, ' ');
    if (at)
        *at++ = 0;
    if (!at || !number(line, &sequence) || sequence < 0 || sequence > 255 || !*at) {
        forget_last("FORM");
        return;
    }
    uint8_t repeatable = strcmp(at, "BEAT") && strcmp(at, "ID");
    if (repeatable && sequence == last_sequence && crc == last_crc) {
        send(reply, reply_size);
        return;
    }
    last_sequence = (int16_t)sequence;
    last_crc = crc;
    for (count = 0; at; count++) {
        if (count == WORDS_MAX)
            break;
        words[count] = at;
        at = strchr(at, ' ');
        if (at)
            *at++ = 0;
    }
    reply_size = 0;
    put_number(sequence);
    if (at) { /* more words than any command has */
        put(" ERR ARGUMENTS");
        seal_and_send();
        return;
    }
    execute();
}

static void take_byte(char c)
{
    if (c == '\r')
        return;
    if (c == '\n') {
        if (line_bad)
            forget_last(line_bad == 1 ? "LONG" : "LOST");
        else if (line_size)
            take_line();
        line_size = line_bad = 0;
    } else if (line_size == LINE_SIZE)
        line_bad = 1;
    else
        line[line_size++] = c;
}

/* ---- Every millisecond */
static void look_at_switches(void)
{
    static uint8_t seen, since;
    uint8_t now = ~PINC;
    now = (uint8_t)((now & NEAR_SWITCH ? 1 : 0) | (now & AWAY_SWITCH ? 2 : 0));
    if (now != seen) {
        seen = now;
        since = 0;
    } else if (since < DEBOUNCE_MS)
        since++;
    else
        switches = now;
}

static void every_millisecond(void)
{
    if (silence < HEARTBEAT_MS)
        silence++;
    if (silence >= HEARTBEAT_MS) {
        set_lamps(0); /* nobody is there any more for whom the magnet should come */
        if (armed) {
            motors_off();
            fault = FAULT_HEARTBEAT;
        }
    }
    ramp(&turn);
    ramp(&steer);
    look_at_switches();
}

int main(void)
{
    uint8_t seen = 0;
    PORTD = ENABLE; /* high before it is an output, so that it never dips */
    DDRD = ENABLE | TURN_STEP | TURN_DIR;
    DDRB = STEER_STEP | STEER_DIR | LED;
    PORTC = NEAR_SWITCH | AWAY_SWITCH;
    DDRC = NEAR_LAMP | AWAY_LAMP;
    if (cause & _BV(WDRF))
        fault = FAULT_WATCHDOG;
    silence = HEARTBEAT_MS;

    UBRR0 = (uint16_t)((F_CPU / 4 / BAUD - 1) / 2);
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    TCCR1A = 0;
    TCCR1B = _BV(CS11); /* 2 MHz, free running: both axes schedule their next step on it */
    TCCR2A = _BV(WGM21);
    TCCR2B = _BV(CS22);
    OCR2A = F_CPU / 64 / 1000 - 1;
    TIMSK2 = _BV(OCIE2A);
    wdt_enable(WATCHDOG);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();

    put("! HELLO " NAME " ");
    put(FAULTS[fault]);
    seal_and_send();

    for (;;) {
        cli();
        if (seen == ticks && rx_in == rx_out) {
            sleep_enable();
            sei();
            sleep_cpu(); /* the instruction after sei runs before any interrupt: nothing is slept through */
            sleep_disable();
        }
        sei();
        if (rx_lost) {
            rx_lost = 0;
            line_bad = 2;
        }
        for (uint8_t most = 16; most && rx_in != rx_out; most--) {
            char c = (char)rx[rx_out];
            rx_out = (uint8_t)(rx_out + 1) % RX_SIZE;
            take_byte(c);
        }
        if (seen != ticks) { /* fed only while the timer runs and this loop follows it */
            seen++;
            every_millisecond();
            wdt_reset();
        }
    }
}
