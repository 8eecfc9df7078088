/* Numbers in the bytes of a record, and where its tables begin. */
#ifndef OSC_BYTES_H
#define OSC_BYTES_H
#include <stddef.h>
#include <stdint.h>
#include <string.h>

static inline int64_t whole(const unsigned char *record, size_t offset) {
    int64_t value;
    memcpy(&value, record + offset, sizeof value);
    return value;
}

static inline int64_t whole32(const unsigned char *record, size_t offset) {
    int32_t value;
    memcpy(&value, record + offset, sizeof value);
    return value;
}

static inline double number(const unsigned char *record, size_t offset) {
    double value;
    memcpy(&value, record + offset, sizeof value);
    return value;
}

/* A table of a record: where it begins stands in the record's first words. */
static inline const unsigned char *record_table(const unsigned char *record, size_t slot) {
    return record + whole(record, 8 * slot);
}
#endif
