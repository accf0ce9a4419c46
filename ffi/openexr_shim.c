#include "openexr_shim.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <openexr.h>

struct LuxelExrReader {
    exr_context_t context;
    LuxelExrHeader header;
    exr_attr_box2i_t window;
    const exr_attr_chlist_t *channels;
    char message[LUXEL_EXR_MESSAGE];
};

/* ---- errors: the library prints them unless told otherwise ---- */

static void keep_message(exr_const_context_t context, exr_result_t code, const char *text) {
    void *message = NULL;
    (void)code;
    if (context && exr_get_user_data(context, &message) == EXR_ERR_SUCCESS && message && text)
        snprintf(message, LUXEL_EXR_MESSAGE, "%s", text);
}

static exr_context_initializer_t initializer(char *message) {
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = keep_message;
    init.user_data = message;
    return init;
}

const char *luxel_exr_error_text(int32_t code) {
    return exr_get_default_error_message(code);
}

void luxel_exr_version(int32_t *major, int32_t *minor, int32_t *patch) {
    const char *extra;
    exr_get_library_version(major, minor, patch, &extra);
}

void luxel_exr_sizes(size_t sizes[3]) {
    sizes[0] = sizeof(LuxelExrHeader);
    sizes[1] = sizeof(LuxelExrChannel);
    sizes[2] = sizeof(LuxelExrAttribute);
}

/* ---- reading ---- */

static bool plain_channels(const exr_attr_chlist_t *channels) {
    for (int c = 0; c < channels->num_channels; c++) {
        const exr_attr_chlist_entry_t *entry = &channels->entries[c];
        if (entry->x_sampling != 1 || entry->y_sampling != 1 || entry->pixel_type == EXR_PIXEL_UINT)
            return false;
    }
    return true;
}

static exr_result_t read_header(LuxelExrReader *reader) {
    exr_const_context_t context = reader->context;
    LuxelExrHeader *header = &reader->header;
    int parts = 0;
    exr_storage_t storage;
    exr_result_t result = exr_get_count(context, &parts);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_storage(context, 0, &storage);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_channels(context, 0, &reader->channels);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_data_window(context, 0, &reader->window);
    if (result == EXR_ERR_SUCCESS)
        result = exr_get_attribute_count(context, 0, &header->attribute_count);
    if (result != EXR_ERR_SUCCESS)
        return result;
    int64_t width = (int64_t)reader->window.max.x - reader->window.min.x + 1;
    int64_t height = (int64_t)reader->window.max.y - reader->window.min.y + 1;
    if (width < 1 || height < 1 || width > INT32_MAX || height > INT32_MAX)
        return EXR_ERR_INVALID_ATTR;
    header->width = (int32_t)width;
    header->height = (int32_t)height;
    header->channel_count = reader->channels->num_channels;
    header->readable = parts == 1 && storage == EXR_STORAGE_SCANLINE && plain_channels(reader->channels);
    return EXR_ERR_SUCCESS;
}

int32_t luxel_exr_open(const char *path, LuxelExrReader **out, LuxelExrHeader *header, char *message) {
    message[0] = 0;
    LuxelExrReader *reader = calloc(1, sizeof *reader);
    if (!reader)
        return EXR_ERR_OUT_OF_MEMORY;
    exr_context_initializer_t init = initializer(reader->message);
    exr_result_t result = exr_start_read(&reader->context, path, &init);
    if (result == EXR_ERR_SUCCESS)
        result = read_header(reader);
    if (result != EXR_ERR_SUCCESS) {
        memcpy(message, reader->message, LUXEL_EXR_MESSAGE);
        luxel_exr_close(reader);
        return result;
    }
    *header = reader->header;
    *out = reader;
    return 0;
}

void luxel_exr_close(LuxelExrReader *reader) {
    if (reader->context)
        exr_finish(&reader->context);
    free(reader);
}

int32_t luxel_exr_channel(const LuxelExrReader *reader, int32_t index, LuxelExrChannel *out) {
    if (index < 0 || index >= reader->header.channel_count)
        return EXR_ERR_ARGUMENT_OUT_OF_RANGE;
    const exr_attr_chlist_entry_t *entry = &reader->channels->entries[index];
    *out = (LuxelExrChannel){.name = entry->name.str, .half = entry->pixel_type == EXR_PIXEL_HALF};
    return 0;
}

int32_t luxel_exr_attribute(const LuxelExrReader *reader, int32_t index, LuxelExrAttribute *out) {
    const exr_attribute_t *attribute;
    exr_result_t result =
        exr_get_attribute_by_index(reader->context, 0, EXR_ATTR_LIST_FILE_ORDER, index, &attribute);
    if (result != EXR_ERR_SUCCESS)
        return result;
    *out = (LuxelExrAttribute){0};
    if (attribute->type == EXR_ATTR_STRING && attribute->string->length >= 0) {
        out->name = attribute->name;
        out->text = attribute->string->str ? attribute->string->str : "";
        out->length = attribute->string->str ? attribute->string->length : 0;
    } else if (attribute->type == EXR_ATTR_FLOAT) {
        out->name = attribute->name;
        out->number = attribute->f;
    }
    return 0;
}

/* Points every channel of the chunk at its rows in the planes. */
static void aim_at_planes(exr_decode_pipeline_t *decoder, float *const *planes, size_t width, size_t row) {
    for (int c = 0; c < decoder->channel_count; c++) {
        exr_coding_channel_info_t *channel = &decoder->channels[c];
        channel->decode_to_ptr = (uint8_t *)(planes[c] + row * width);
        channel->user_bytes_per_element = sizeof(float);
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_pixel_stride = sizeof(float);
        channel->user_line_stride = (int32_t)(width * sizeof(float));
    }
}

int32_t luxel_exr_read(LuxelExrReader *reader, float *const *planes, char *message) {
    const LuxelExrHeader *header = &reader->header;
    exr_const_context_t context = reader->context;
    message[0] = reader->message[0] = 0;
    if (!header->readable || header->width > INT32_MAX / (int32_t)sizeof(float))
        return EXR_ERR_FEATURE_NOT_IMPLEMENTED;
    int32_t lines = 0;
    exr_result_t result = exr_get_scanlines_per_chunk(context, 0, &lines);
    exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
    bool started = false;
    for (int64_t row = 0; result == EXR_ERR_SUCCESS && row < header->height; row += lines) {
        exr_chunk_info_t chunk;
        result = exr_read_scanline_chunk_info(context, 0, (int)(reader->window.min.y + row), &chunk);
        if (result != EXR_ERR_SUCCESS)
            break;
        /* The planes end with the last row, whatever the chunk says. */
        if (lines < 1 || chunk.width != header->width || chunk.start_y != reader->window.min.y + row ||
            chunk.height < 1 || row + chunk.height > header->height) {
            result = EXR_ERR_CORRUPT_CHUNK;
            break;
        }
        result = started ? exr_decoding_update(context, 0, &chunk, &decoder)
                         : exr_decoding_initialize(context, 0, &chunk, &decoder);
        if (result != EXR_ERR_SUCCESS)
            break;
        if (decoder.channel_count != header->channel_count) {
            result = EXR_ERR_CORRUPT_CHUNK;
            break;
        }
        aim_at_planes(&decoder, planes, (size_t)header->width, (size_t)row);
        if (!started)
            result = exr_decoding_choose_default_routines(context, 0, &decoder);
        started = true;
        if (result == EXR_ERR_SUCCESS)
            result = exr_decoding_run(context, 0, &decoder);
    }
    exr_decoding_destroy(context, &decoder);
    memcpy(message, reader->message, LUXEL_EXR_MESSAGE);
    return result;
}

/* ---- writing ---- */

static exr_result_t write_header(exr_context_t context, int32_t width, int32_t height, int32_t compression,
                                 const LuxelExrChannel *channels, int32_t channel_count,
                                 const LuxelExrAttribute *attributes, int32_t attribute_count) {
    int part = 0;
    exr_result_t result = EXR_ERR_SUCCESS;
    /* Names of up to 31 bytes can be read by every version; the flag for longer ones is set only when needed. */
    bool long_names = false;
    for (int32_t c = 0; c < channel_count; c++)
        long_names |= strlen(channels[c].name) > 31;
    for (int32_t a = 0; a < attribute_count; a++)
        long_names |= strlen(attributes[a].name) > 31;
    if (long_names)
        result = exr_set_longname_support(context, 1);
    if (result == EXR_ERR_SUCCESS)
        result = exr_add_part(context, "", EXR_STORAGE_SCANLINE, &part);
    if (result == EXR_ERR_SUCCESS)
        result = exr_initialize_required_attr_simple(context, part, width, height, (exr_compression_t)compression);
    for (int32_t c = 0; result == EXR_ERR_SUCCESS && c < channel_count; c++)
        result = exr_add_channel(context, part, channels[c].name, channels[c].half ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT,
                                 EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    for (int32_t a = 0; result == EXR_ERR_SUCCESS && a < attribute_count; a++)
        result = attributes[a].text ? exr_attr_set_string(context, part, attributes[a].name, attributes[a].text)
                                    : exr_attr_set_float(context, part, attributes[a].name, attributes[a].number);
    if (result == EXR_ERR_SUCCESS)
        result = exr_write_header(context);
    return result;
}

static exr_result_t write_pixels(exr_context_t context, int32_t width, int32_t height,
                                 const LuxelExrChannel *channels, int32_t channel_count) {
    int32_t lines = 0;
    exr_result_t result = exr_get_scanlines_per_chunk(context, 0, &lines);
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    bool started = false;
    for (int64_t row = 0; result == EXR_ERR_SUCCESS && row < height; row += lines) {
        exr_chunk_info_t chunk;
        result = exr_write_scanline_chunk_info(context, 0, (int)row, &chunk);
        if (result != EXR_ERR_SUCCESS)
            break;
        result = started ? exr_encoding_update(context, 0, &chunk, &encoder)
                         : exr_encoding_initialize(context, 0, &chunk, &encoder);
        if (result != EXR_ERR_SUCCESS)
            break;
        for (int c = 0; c < channel_count; c++) {
            exr_coding_channel_info_t *channel = &encoder.channels[c];
            if (strcmp(channel->channel_name, channels[c].name) != 0) {
                result = EXR_ERR_INVALID_ARGUMENT;
                break;
            }
            channel->encode_from_ptr = (const uint8_t *)(channels[c].values + (size_t)row * (size_t)width);
            channel->user_bytes_per_element = sizeof(float);
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = sizeof(float);
            channel->user_line_stride = width * (int32_t)sizeof(float);
        }
        if (result == EXR_ERR_SUCCESS && !started)
            result = exr_encoding_choose_default_routines(context, 0, &encoder);
        started = true;
        if (result == EXR_ERR_SUCCESS)
            result = exr_encoding_run(context, 0, &encoder);
    }
    exr_encoding_destroy(context, &encoder);
    return result;
}

int32_t luxel_exr_write(const char *path, int32_t width, int32_t height, int32_t compression,
                        const LuxelExrChannel *channels, int32_t channel_count,
                        const LuxelExrAttribute *attributes, int32_t attribute_count, char *message) {
    exr_context_t context = NULL;
    message[0] = 0;
    if (width < 1 || height < 1 || width > INT32_MAX / (int32_t)sizeof(float))
        return EXR_ERR_INVALID_ARGUMENT;
    exr_context_initializer_t init = initializer(message);
    exr_result_t result = exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (result == EXR_ERR_SUCCESS)
        result = write_header(context, width, height, compression, channels, channel_count, attributes,
                              attribute_count);
    if (result == EXR_ERR_SUCCESS)
        result = write_pixels(context, width, height, channels, channel_count);
    if (context) {
        /* The offset table is written here. */
        exr_result_t finished = exr_finish(&context);
        if (result == EXR_ERR_SUCCESS)
            result = finished;
    }
    return result;
}
