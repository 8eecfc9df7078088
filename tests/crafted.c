/* Reads files of controllers, one behind the other with their sizes; counts those refused. */
#include "osc_controller.h"

#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words) {
    FILE *stream = count > 1 ? fopen(words[1], "rb") : NULL;
    uint64_t size;
    int refused = 0;
    if (stream == NULL) return 2;
    while (fread(&size, sizeof size, 1, stream) == 1) {
        unsigned char *file = malloc(size); /* of this size, so that a sanitizer sees beyond */
        osc_controller *c;
        if (file == NULL || fread(file, 1, size, stream) != size) return 2;
        if (osc_create_from(file, size, &c) == OSC_DAMAGED && c == NULL) refused++;
        osc_destroy(c);
        free(file);
    }
    fclose(stream);
    printf("%d refused\n", refused);
    return 0;
}
