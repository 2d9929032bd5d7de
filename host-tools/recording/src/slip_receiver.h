/* The receiver: what each frame was, and whether the flag may be believed now. One state per module, zeroed at first but
 * for the node. All times are microseconds of one clock, which never goes back. */
#define SLIPSENSE_TIMEOUT_US 12500U
#define SLIPSENSE_AGE_MAX_US 12500
#define SLIPSENSE_JITTER_US 2083
#define SLIPSENSE_LOST_MAX 2U
#define SLIPSENSE_STARTING_MESSAGES 3U

typedef enum {
    SLIPSENSE_OK = 0,             /* The next message. */
    SLIPSENSE_SOME_LOST = 1,      /* A later one; those between are lost. */
    SLIPSENSE_REPEATED = 2,       /* Not accepted, nor are those below. */
    SLIPSENSE_WRONG_SEQUENCE = 3, /* Earlier, of an earlier start even, or too far ahead. */
    SLIPSENSE_DELAYED = 4,        /* Took longer than the quickest by more than SLIPSENSE_AGE_MAX_US. */
    SLIPSENSE_ERROR = 5           /* Length, tail byte, CRC, class. */
} slipsense_check_t;

typedef enum {
    SLIPSENSE_NO_DATA = 0,  /* Nothing accepted within SLIPSENSE_TIMEOUT_US. */
    SLIPSENSE_STARTING = 1, /* Too few accepted, or the module starts. */
    SLIPSENSE_VALID = 2,    /* Act on message.slip. */
    SLIPSENSE_INVALID = 3   /* message.invalid says why. */
} slipsense_state_t;

typedef struct {
    uint8_t node;
    uint8_t accepted; /* In a row, up to SLIPSENSE_STARTING_MESSAGES. */
    bool any;         /* Was one accepted? */
    uint32_t lost; /* Messages known to be lost, wraps. */
    uint64_t arrived_us;
    uint64_t least_us; /* Least difference of arrival and timestamp, raised by 1/256 of the time. */
    slipsense_slip_t message; /* Accepted last. */
} slipsense_receiver_t;

/* Take the data of a frame with the identifier of the module's slip message. */
static inline slipsense_check_t slipsense_receive(slipsense_receiver_t *r, const uint8_t *data, size_t length,
                                                  uint64_t now_us) {
    slipsense_slip_t message;
    if (slipsense_slip_decode(r->node, data, length, &message) != 0) return SLIPSENSE_ERROR;
    const uint64_t offset_us = now_us - message.timestamp_us;
    const uint64_t since_us = now_us > r->arrived_us ? now_us - r->arrived_us : 0U;
    uint32_t lost = 0U;
    uint8_t accepted = 0U;
    int64_t late_us = 0;
    if (r->any) {
        const bool silent = since_us > SLIPSENSE_TIMEOUT_US;
        const uint8_t restarts = (uint8_t)(message.starts - r->message.starts);
        if (restarts == 0U && !silent) {
            const uint32_t ahead = message.sequence - r->message.sequence;
            if (ahead == 0U) return SLIPSENSE_REPEATED;
            if (ahead > SLIPSENSE_LOST_MAX + 1U) return SLIPSENSE_WRONG_SEQUENCE;
            lost = ahead - 1U;
            accepted = r->accepted;
        } else if (restarts > 127U && !silent) {
            return SLIPSENSE_WRONG_SEQUENCE;
        }
        /* Without its supply a module forgets its starts, and its clock. */
        if (restarts == 0U && message.timestamp_us > r->message.timestamp_us) {
            late_us = (int64_t)(offset_us - (r->least_us + since_us / 256U));
            const int64_t slower_us = (int64_t)(offset_us - (r->arrived_us - r->message.timestamp_us));
            const bool starting = accepted < SLIPSENSE_STARTING_MESSAGES && slower_us < -SLIPSENSE_JITTER_US;
            /* Then those before were delayed: what waited somewhere comes in a burst. */
            if (starting || late_us < -SLIPSENSE_JITTER_US) accepted = 0U;
        }
    }
    if (late_us > SLIPSENSE_AGE_MAX_US) return SLIPSENSE_DELAYED;
    r->lost += lost;
    r->least_us = offset_us - (uint64_t)(late_us > 0 ? late_us : 0);
    r->accepted = accepted < SLIPSENSE_STARTING_MESSAGES ? (uint8_t)(accepted + 1U) : accepted;
    r->arrived_us = now_us;
    r->message = message;
    r->any = true;
    return lost > 0U ? SLIPSENSE_SOME_LOST : SLIPSENSE_OK;
}

/* May the flag of r->message be believed at this time? */
static inline slipsense_state_t slipsense_state(const slipsense_receiver_t *r, uint64_t now_us) {
    if (!r->any || (now_us > r->arrived_us && now_us - r->arrived_us > SLIPSENSE_TIMEOUT_US)) {
        return SLIPSENSE_NO_DATA;
    }
    if ((r->message.invalid & (uint8_t)~SLIPSENSE_INVALID_STARTING) != 0U) return SLIPSENSE_INVALID;
    if (r->message.invalid != 0U || r->accepted < SLIPSENSE_STARTING_MESSAGES) return SLIPSENSE_STARTING;
    return SLIPSENSE_VALID;
}
