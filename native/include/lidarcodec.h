/* Decoder of lidarcodec streams for C and C++: bytes of messages in, images and points of frames out.
 *
 * A session decodes one stream, message after message, as a recording or a subscription has them. Codecs: raw, zstd,
 * pcodec, predictive, riddle; others are refused by name. Nothing here throws, prints or ends the process. A session is
 * used by one thread at a time; several sessions may be used by several threads at once. */
#ifndef LIDARCODEC_H
#define LIDARCODEC_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#define LIDARCODEC_API
#else
#define LIDARCODEC_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum { LIDARCODEC_ROWS = 64 };

/* What became of a call. After each of them the next message can be pushed. */
typedef enum lidarcodec_status {
  LIDARCODEC_OK = 0,
  LIDARCODEC_BAD_HEADER = 1,        /* no message, or one whose header contradicts itself */
  LIDARCODEC_UNSUPPORTED = 2,       /* a newer format, or a codec that is not decoded here */
  LIDARCODEC_TRUNCATED = 3,         /* fewer bytes than announced */
  LIDARCODEC_BAD_CHECKSUM = 4,      /* the checksum does not match */
  LIDARCODEC_BAD_SECTION = 5,       /* a section that cannot be what it says */
  LIDARCODEC_MISSING_REFERENCE = 6, /* a frame, calibration or weights that were not received: ask for a key frame */
  LIDARCODEC_OUT_OF_MEMORY = 7,
  LIDARCODEC_FAILED = 8 /* anything else: a fault of this library */
} lidarcodec_status;

typedef struct lidarcodec_session lidarcodec_session;

/* A frame of 64 rows, row 0 the highest beam, and `width` columns. Images are stored row after row. All pointers hold
 * until the next call with the session. */
typedef struct lidarcodec_frame {
  uint64_t stream_id;
  uint64_t index;        /* counts frames of a stream from 0 */
  int64_t stamp_ns;      /* host time of the first packet, ns since 1970-01-01 UTC */
  uint16_t codec;        /* number of the codec, docs/wire-format.md */
  uint8_t key;           /* 1: decoded without any message before it */
  uint8_t has_intensity; /* 0: the stream sends none, all are 0 */
  uint32_t width;
  uint32_t points;          /* returns in the frame */
  double range_step_m;      /* metres of one step of `range` */
  const uint16_t* range;    /* 64 x width, steps, 0 = no return */
  const uint8_t* intensity; /* 64 x width, as the sensor sends it */
  const uint16_t* azimuth;  /* 2 x width: of the upper and lower half of each column, 0.01 degree, 0 to 35999 */
  const uint8_t* fired;     /* 2 x width: 1 where the half of a column was sent */
  const uint8_t* laser;     /* 64: hardware id of the laser of each row; ids from 32 on are in the lower half */
  const double* pose;       /* 3 x 4, the first rows of T_world_sensor, row after row; NULL where it is not known */
  const char* sensor;       /* name of the sensor's model, UTF-8 */
} lidarcodec_frame;

/* Metres; x forward, y left, z up, of the sensor. ring: the row, 0 at the top. */
typedef struct lidarcodec_point {
  float x, y, z;
  uint8_t intensity, laser, ring, reserved;
} lidarcodec_point;

/* A new session; NULL without memory, which no other function but `lidarcodec_close` takes. Bytes and points may be
 * NULL where their size is 0. */
LIDARCODEC_API lidarcodec_session* lidarcodec_open(void);
LIDARCODEC_API void lidarcodec_close(lidarcodec_session* session);

/* Gives the session a weight file (.lcrw) of codec riddle that streams may name without sending it, such as those
 * installed in share/lidarcodec/weights. Its name is the hash of its bytes. */
LIDARCODEC_API lidarcodec_status lidarcodec_give_weights(lidarcodec_session* session, const uint8_t* data, size_t size);

/* Decodes one whole message. `frame` is set where the status is LIDARCODEC_OK, else left as it was; NULL where only
 * points are wanted. */
LIDARCODEC_API lidarcodec_status lidarcodec_push(lidarcodec_session* session, const uint8_t* message, size_t size,
                                                 lidarcodec_frame* frame);

/* Points of the frame that was pushed last, column by column: up to `capacity` of them are written. Returns how many
 * there are. Without memory it returns 0. */
LIDARCODEC_API size_t lidarcodec_points(const lidarcodec_session* session, lidarcodec_point* points, size_t capacity);

/* Of the last call that failed: a sentence in English, the byte at which it was seen, and with
 * LIDARCODEC_MISSING_REFERENCE the index of the frame that is needed. The sentence holds until the next call. */
LIDARCODEC_API const char* lidarcodec_error_text(const lidarcodec_session* session);
LIDARCODEC_API uint64_t lidarcodec_error_offset(const lidarcodec_session* session);
LIDARCODEC_API uint64_t lidarcodec_error_needs(const lidarcodec_session* session);

#ifdef __cplusplus
}
#endif

#endif
