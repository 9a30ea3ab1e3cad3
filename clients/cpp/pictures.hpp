// Decoders of pictures for a session: H.264 by FFmpeg, JPEG by libjpeg-turbo from version 3 on, which has 12 bits. What
// CMake does not find is left out, and the session then refuses these codecs by name.
#pragma once
#include <lidarcodec.h>

#ifdef WITH_FFMPEG
extern "C" {
#include <libavcodec/avcodec.h>
#include <libavutil/log.h>
}
#endif
#ifdef WITH_JPEG
#include <jpeglib.h>
#include <stdio.h>  // before jpeglib.h

#include <csetjmp>
#endif

#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#ifdef WITH_FFMPEG
// A stream of H.264 pictures, one in and one out.
class Film {
 public:
  // lidarcodec_open_picture; context: a Film
  static int open(void* context, const lidarcodec_picture* picture, uint16_t* samples) {
    return static_cast<Film*>(context)->decode(*picture, samples) ? 1 : 0;
  }

 private:
  struct Free {
    void operator()(AVCodecContext* decoder) const { avcodec_free_context(&decoder); }
    void operator()(AVPacket* packet) const { av_packet_free(&packet); }
    void operator()(AVFrame* frame) const { av_frame_free(&frame); }
  };

  bool decode(const lidarcodec_picture& picture, uint16_t* samples) {
    if (picture.begins != 0) begin(picture);
    std::unique_ptr<AVPacket, Free> packet(av_packet_alloc());
    std::unique_ptr<AVFrame, Free> frame(av_frame_alloc());
    if (!decoder_ || !packet || !frame || av_new_packet(packet.get(), static_cast<int>(picture.size)) < 0) return false;
    std::memcpy(packet->data, picture.data, picture.size);  // FFmpeg reads beyond the end: its packets have room there
    if (avcodec_send_packet(decoder_.get(), packet.get()) < 0 || avcodec_receive_frame(decoder_.get(), frame.get()) < 0)
      return false;
    const bool eight = frame->format == AV_PIX_FMT_GRAY8 || frame->format == AV_PIX_FMT_YUV420P;
    const bool ten = frame->format == AV_PIX_FMT_GRAY10LE || frame->format == AV_PIX_FMT_YUV420P10LE;
    if (frame->width != static_cast<int>(picture.width) || frame->height != static_cast<int>(picture.rows) ||
        !(picture.bits == 8 ? eight : ten) || (frame->flags & AV_FRAME_FLAG_CORRUPT) != 0)
      return false;
    for (size_t row = 0; row < picture.rows; ++row) {
      const uint8_t* const line = frame->data[0] + static_cast<ptrdiff_t>(row) * frame->linesize[0];
      for (size_t column = 0; column < picture.width; ++column)
        *samples++ = eight ? line[column] : static_cast<uint16_t>(line[2 * column] | line[2 * column + 1] << 8);
    }
    return true;
  }

  void begin(const lidarcodec_picture& picture) {
    av_log_set_level(AV_LOG_QUIET);
    decoder_.reset(avcodec_alloc_context3(avcodec_find_decoder(AV_CODEC_ID_H264)));
    if (!decoder_) return;
    decoder_->thread_count = 1;  // more of them hold pictures back
    decoder_->flags |= AV_CODEC_FLAG_LOW_DELAY;
    decoder_->err_recognition = AV_EF_EXPLODE;
    decoder_->max_pixels = int64_t{picture.width + 128} * (picture.rows + 128);
    if (avcodec_open2(decoder_.get(), decoder_->codec, nullptr) < 0) decoder_.reset();
  }

  std::unique_ptr<AVCodecContext, Free> decoder_;
};
#endif

#ifdef WITH_JPEG
// A JPEG of 8 or 12 bits.
class Jpeg {
 public:
  // lidarcodec_open_picture
  static int open(void*, const lidarcodec_picture* picture, uint16_t* samples) {
    std::vector<uint8_t> narrow(picture->bits == 8 ? picture->width : 0);  // before setjmp: it is freed in any case
    Errors errors;
    jpeg_decompress_struct jpeg;
    jpeg.err = jpeg_std_error(&errors.manager);
    errors.manager.error_exit = [](j_common_ptr of) { std::longjmp(reinterpret_cast<Errors*>(of->err)->back, 1); };
    errors.manager.emit_message = [](j_common_ptr of, int level) {
      if (level < 0) of->err->error_exit(of);  // a warning: the bytes are damaged
    };
    if (setjmp(errors.back) != 0) {
      jpeg_destroy_decompress(&jpeg);
      return 0;
    }
    jpeg_create_decompress(&jpeg);
    jpeg_mem_src(&jpeg, picture->data, static_cast<unsigned long>(picture->size));
    jpeg_read_header(&jpeg, TRUE);
    jpeg_start_decompress(&jpeg);
    while (jpeg.output_scanline < picture->rows) {
      uint16_t* const line = samples + size_t{jpeg.output_scanline} * picture->width;
      if (picture->bits == 8) {
        JSAMPROW row = narrow.data();
        jpeg_read_scanlines(&jpeg, &row, 1);
        for (size_t column = 0; column < picture->width; ++column) line[column] = narrow[column];
      } else {
        J12SAMPROW row = reinterpret_cast<J12SAMPROW>(line);
        jpeg12_read_scanlines(&jpeg, &row, 1);
      }
    }
    jpeg_finish_decompress(&jpeg);
    jpeg_destroy_decompress(&jpeg);
    return 1;
  }

 private:
  struct Errors {
    jpeg_error_mgr manager;  // the first, which libjpeg points to
    std::jmp_buf back;
  };
};
#endif

// What a session opens pictures by.
class Decoders {
 public:
  void give([[maybe_unused]] lidarcodec_session* session) {
#ifdef WITH_JPEG
    for (const uint16_t codec : {uint16_t{6}, uint16_t{7}})
      lidarcodec_give_pictures(session, codec, Jpeg::open, nullptr);
#endif
#ifdef WITH_FFMPEG
    for (const uint16_t codec : {uint16_t{8}, uint16_t{9}})
      lidarcodec_give_pictures(session, codec, Film::open, &film_);
#endif
  }

 private:
#ifdef WITH_FFMPEG
  Film film_;
#endif
};
