/* A small C face of OpenEXRCore 3.1 and later: whole single-part scanline images, channel by channel. */
#ifndef LUXEL_OPENEXR_SHIM_H
#define LUXEL_OPENEXR_SHIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A file opened for reading. */
typedef struct LuxelExrReader LuxelExrReader;

typedef struct LuxelExrHeader {
    int32_t width, height;
    int32_t channel_count, attribute_count;
    /* One part, scanlines, half or float channels without subsampling: what luxel_exr_read reads. */
    bool readable;
} LuxelExrHeader;

/* `values` has width * height floats, top row first; stored as half floats if `half`. */
typedef struct LuxelExrChannel {
    const char *name;
    bool half;
    const float *values;
} LuxelExrChannel;

/* Text of `length` bytes where `text` is not null, else `number`. Other kinds of attribute, which only occur when
   reading, have a null name. */
typedef struct LuxelExrAttribute {
    const char *name;
    const char *text;
    int32_t length;
    float number;
} LuxelExrAttribute;

/* Room for the library's own words on an error. */
enum { LUXEL_EXR_MESSAGE = 256 };

/* Functions return 0 or an OpenEXR error code. `message`, of LUXEL_EXR_MESSAGE bytes and always ended by 0, says more
   where the library does. */

/* Sets *out only on success. */
int32_t luxel_exr_open(const char *path, LuxelExrReader **out, LuxelExrHeader *header, char *message);
/* Pointers handed out stay valid until luxel_exr_close. */
int32_t luxel_exr_channel(const LuxelExrReader *reader, int32_t index, LuxelExrChannel *out);
int32_t luxel_exr_attribute(const LuxelExrReader *reader, int32_t index, LuxelExrAttribute *out);
/* planes[c] receives width * height floats for every channel c, in the order of the file. */
int32_t luxel_exr_read(LuxelExrReader *reader, float *const *planes, char *message);
void luxel_exr_close(LuxelExrReader *reader);

/* Writes a whole file. `channels` must be sorted by name; `compression` is the number in the file format
   (0 none, 1 RLE, 2 ZIPS, 3 ZIP, 4 PIZ). */
int32_t luxel_exr_write(const char *path, int32_t width, int32_t height, int32_t compression,
                        const LuxelExrChannel *channels, int32_t channel_count,
                        const LuxelExrAttribute *attributes, int32_t attribute_count, char *message);

/* A text for an error code; static storage. */
const char *luxel_exr_error_text(int32_t code);
void luxel_exr_version(int32_t *major, int32_t *minor, int32_t *patch);

/* What C says about the sizes of header, channel and attribute. */
void luxel_exr_sizes(size_t sizes[3]);

#endif
