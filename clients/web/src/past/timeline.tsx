import { moment } from "../model/format";
import { type Bar, barsOf, rowText, type Span } from "./spans";

interface Props {
  beginMs: number;
  endMs: number;
  /** On the vehicle, exact; this and others are null if they are not known. */
  vehicle: Span[] | null;
  /** How old that is, as text; empty if it is fresh. */
  asOf: string;
  /** Here, exact. */
  here: Span[] | null;
  coming: Span[];
  /** Here, as the vehicle sent it live. */
  recorded: Span[] | null;
}

/** Which times are on the vehicle, and which are here in which quality. Screen readers get the same in words. */
export function TimeLine({ beginMs, endMs, vehicle, asOf, here, coming, recorded }: Props) {
  const bars = (spans: Span[] | null) => barsOf(spans ?? [], beginMs, endMs);
  const text = (spans: Span[] | null) => (spans === null ? "not known now" : rowText(spans));
  /** An empty row would look as if there were nothing. */
  const unknown = (spans: Span[] | null) => (spans === null ? ", not known now" : "");
  const asked = coming.length > 0 ? `; on its way: ${rowText(coming)}` : "";
  return (
    <dl class="timeline">
      <dt>
        On the vehicle, exact
        {unknown(vehicle)}
        {asOf}
      </dt>
      <Row look={asOf === "" ? "exact" : "exact old"} bars={bars(vehicle)} text={text(vehicle)} />
      <dt>
        Here, exact
        {unknown(here)}
      </dt>
      <Row look="exact" bars={bars(here)} coming={bars(coming)} text={text(here) + asked} />
      <dt>
        Here, as it was sent
        {unknown(recorded)}
      </dt>
      <Row look="sent" bars={bars(recorded)} text={text(recorded)} />
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
