import { moment } from "../model/format";
import { type Bar, barsOf, rowText, type Span } from "./spans";

interface Props {
  beginMs: number;
  endMs: number;
  /** On the vehicle, exact; null if it does not answer. */
  vehicle: Span[] | null;
  /** Here, exact. */
  here: Span[];
  coming: Span[];
  /** Here, as the vehicle sent it live. */
  recorded: Span[];
}

/** Which times are on the vehicle, and which are here in which quality. The same is said in words to readers of screens. */
export function TimeLine({ beginMs, endMs, vehicle, here, coming, recorded }: Props) {
  const bars = (spans: Span[]) => barsOf(spans, beginMs, endMs);
  const asked = coming.length > 0 ? `; on its way: ${rowText(coming)}` : "";
  return (
    <dl class="timeline">
      <dt>On the vehicle, exact</dt>
      <Row look="exact" bars={bars(vehicle ?? [])} text={vehicle === null ? "not known now" : rowText(vehicle)} />
      <dt>Here, exact</dt>
      <Row look="exact" bars={bars(here)} coming={bars(coming)} text={rowText(here) + asked} />
      <dt>Here, as it was sent</dt>
      <Row look="sent" bars={bars(recorded)} text={rowText(recorded)} />
      <dt aria-hidden="true" />
      <dd class="ends quiet" aria-hidden="true">
        <span>{moment(new Date(beginMs).toISOString())}</span>
        <span>{moment(new Date(endMs).toISOString())}</span>
      </dd>
    </dl>
  );
}

function Row({ look, bars, coming = [], text }: { look: string; bars: Bar[]; coming?: Bar[]; text: string }) {
  return (
    <dd class={look} title={text}>
      <span class="hidden">{text}</span>
      {coming.map((bar) => (
        <Piece key={`coming ${bar.left}`} look="bar coming" bar={bar} />
      ))}
      {bars.map((bar) => (
        <Piece key={bar.left} look="bar" bar={bar} />
      ))}
    </dd>
  );
}

function Piece({ look, bar }: { look: string; bar: Bar }) {
  return <span class={look} style={{ left: `${bar.left}%`, width: `${bar.width}%` }} />;
}
